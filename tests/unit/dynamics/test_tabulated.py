import numpy as np
import pytest

from dftc_rt.dynamics.local_terms import LocalTerms
from dftc_rt.dynamics.robot import load_robot
from dftc_rt.dynamics.tabulated import TabulatedTerms
from dftc_rt.errors import InputError

ROBOTS = {
    "panda": load_robot("panda"),
    "kinova": load_robot(urdf="kinova_description/robots/kinova.urdf"),  # nq != nv
}


def reference(robot, cycles=60):
    rng = np.random.default_rng(3)
    phase, omega = rng.uniform(0.0, 6.0, robot.n), rng.uniform(0.5, 3.0, robot.n)
    angle = 0.05 * np.arange(cycles)[:, None] * omega + phase
    return (
        robot.home + 0.3 * np.sin(angle),
        0.3 * omega * np.cos(angle),
        -0.3 * omega**2 * np.sin(angle),
    )


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("interconnection", ["frozen", "desired"])
def test_exact_on_the_reference_and_first_order_beside_it(name, interconnection):
    robot = ROBOTS[name]
    qd, vd, ad = reference(robot)
    table = TabulatedTerms(robot, interconnection, qd, vd, ad)
    exact = LocalTerms(robot, interconnection)
    for k in range(len(qd)):
        table.update(k, qd[k], vd[k])
        exact.update(qd[k], vd[k], qd[k], vd[k], ad[k])
        np.testing.assert_allclose(table.inertia, exact.inertia, rtol=1e-9)
        np.testing.assert_allclose(table.bias, exact.bias, rtol=0, atol=1e-9)
    # The remainder is of second order: a tenth of the distance, a hundredth of the error.
    near, far = (table.error(d, 10.0 * d, samples=50, seed=1).bias.max() for d in (1e-4, 1e-3))
    assert 0.0 < near < 1e-3
    assert far / near == pytest.approx(100.0, rel=0.05)


def test_the_table_is_one_stretch_per_cycle_and_the_last_row_holds():
    robot = ROBOTS["panda"]
    qd, vd, ad = reference(robot, cycles=5)
    table = TabulatedTerms(robot, "desired", qd, vd, ad)
    assert table.table.shape == (5, 4, 7)
    assert table.table.flags.c_contiguous
    table.update(4, qd[0], vd[0])
    inertia, bias = table.inertia.copy(), table.bias.copy()
    table.update(4000, qd[0], vd[0])
    np.testing.assert_array_equal(table.inertia, inertia)
    np.testing.assert_array_equal(table.bias, bias)


def test_local_bit_by_bit():
    robot = ROBOTS["panda"]
    qd, vd, ad = reference(robot, cycles=3)
    table = TabulatedTerms(robot, "desired", qd, vd, ad)
    table.update(1, qd[1], vd[1])
    before = table.bias.copy()
    q, v = qd[1].copy(), vd[1].copy()
    q[2], v[2] = q[2] + 0.1, v[2] + 1.0
    table.update(1, q, v)
    assert np.flatnonzero(table.bias != before).tolist() == [2]


def test_error_reports_the_inertia_too():
    robot = ROBOTS["panda"]
    table = TabulatedTerms(robot, "desired", *reference(robot, cycles=5))
    table.table[:, 0, 3] += 0.5
    assert table.error(0.0, 0.0).inertia[3] == pytest.approx(0.5)


def test_what_cannot_be_tabulated():
    robot = ROBOTS["panda"]
    qd, vd, ad = reference(robot, cycles=3)
    with pytest.raises(InputError, match="'measured', which no table can hold"):
        TabulatedTerms(robot, "measured", qd, vd, ad)
    with pytest.raises(InputError, match=r"reference: found shapes \(3, 7\), \(2, 7\), \(3, 7\)"):
        TabulatedTerms(robot, "desired", qd, vd[:2], ad)
    with pytest.raises(InputError, match="K from 1"):
        TabulatedTerms(robot, "desired", qd[:0], vd[:0], ad[:0])
    with pytest.raises(InputError, match="found 'local'"):
        LocalTerms(robot, "local")
