"""Robots with a closed form: how they load, what their URDFs say, what is refused."""

import typing

import numpy as np
import pytest

from dftc_rt.config.robot import Plant, robot_names
from dftc_rt.dynamics.closed_form.plants import CLOSED_FORMS
from dftc_rt.dynamics.robot import load_robot
from dftc_rt.dynamics.select import local_terms, whole_body
from dftc_rt.dynamics.surrogate import INTERCONNECTIONS
from dftc_rt.dynamics.tabulated import TabulatedTerms
from dftc_rt.dynamics.whole_body import WholeBody
from dftc_rt.errors import InputError
from tests.unit.dynamics.test_robot import LIMIT, refused, urdf_of

ZERO = np.zeros(2)


def test_every_closed_form_can_be_named_and_has_its_robot():
    assert set(typing.get_args(Plant)) == set(CLOSED_FORMS)
    assert set(CLOSED_FORMS) <= set(robot_names())
    for name, form in CLOSED_FORMS.items():
        robot = load_robot(plant=name)
        assert robot.closed_form is form
        assert robot.name == name
        assert robot.n == form.n
        assert robot.armature.tolist() == [0.0] * form.n


def test_by_name_the_pendulums_are_closed_forms_and_the_arm_is_its_urdf():
    assert load_robot("pendulums").closed_form is CLOSED_FORMS["pendulums"]
    assert load_robot("pendulums_physical").closed_form is CLOSED_FORMS["pendulums_physical"]
    assert load_robot("arm2").closed_form is None


@pytest.mark.parametrize(
    ("name", "inertia", "weight"), [("pendulums", 1.0, 5.88), ("pendulums_physical", 0.25, 4.9)]
)
def test_urdf_of_the_pendulums_is_them_without_spring_and_damping(name, inertia, weight):
    robot = load_robot(name)
    urdf, closed = WholeBody(robot), whole_body(robot)
    assert robot.joints == ("pendulum1", "pendulum2")
    for angle in (-2.0, 0.0, 0.7):
        q = np.array([angle, angle])  # the spring is as long as at rest
        expected = -weight * np.sin(q)  # the torque that holds it falls away from the upright
        np.testing.assert_allclose(urdf.gravity(q), expected, rtol=0, atol=1e-12)
        np.testing.assert_allclose(closed.inverse_dynamics(q, ZERO, ZERO), expected, atol=1e-12)
        for body in (urdf, closed):
            M = body.mass_matrix(q)
            np.testing.assert_allclose(M, inertia * np.eye(2), rtol=0, atol=1e-12)
    placements = robot.model.jointPlacements
    apart = placements[2].translation - placements[1].translation
    assert apart.tolist() == [1.0, 0.0, 0.0]


def test_pendulums_hold_themselves_at_home_with_ease():
    for name in ("pendulums", "pendulums_physical"):
        robot = load_robot(name)
        holding = whole_body(robot).inverse_dynamics(robot.home, ZERO, ZERO)
        assert (np.abs(holding) < 0.35 * robot.torque_limit).all()
        assert not robot.torque_limit_assumed.any()
        assert {drive.bus for drive in robot.joint_config} == {"can0"}


@pytest.mark.parametrize("interconnection", INTERCONNECTIONS)
def test_local_terms_are_written_in_place_and_compiled_before_the_first_update(interconnection):
    robot = load_robot("pendulums")
    terms = local_terms(robot, interconnection)
    inertia, bias = terms.inertia, terms.bias
    before = [len(f.signatures) for f in kernels(robot)]
    q = robot.home  # read-only, as warm-up has it
    terms.update(q, ZERO, q, ZERO, ZERO)
    rows = np.zeros((14, 2))  # as the loop has it
    terms.update(rows[0], rows[1], *rows[2:5])
    assert terms.inertia is inertia
    assert terms.bias is bias
    assert [len(f.signatures) for f in kernels(robot)] == before


def kernels(robot):
    form = robot.closed_form
    return (form.inverse_dynamics, form.forward_dynamics, form.mass_matrix, form.local_terms)


def test_frozen_puts_the_other_pendulum_where_it_is_told():
    robot = load_robot("pendulums_physical")
    q, v, frozen = np.array([0.4, -1.1]), np.array([1.5, -2.0]), np.array([0.3, 0.8])
    terms = local_terms(robot, "frozen", frozen)
    terms.update(q, v, ZERO, ZERO, ZERO)
    body = whole_body(robot)
    for i in range(2):
        x, w = frozen.copy(), np.zeros(2)
        x[i], w[i] = q[i], v[i]
        assert terms.bias[i] == pytest.approx(body.inverse_dynamics(x, w, ZERO)[i], abs=1e-14)
    assert terms.inertia.tolist() == [0.25, 0.25]


# --- what is refused -----------------------------------------------------------------------


def test_what_a_closed_form_cannot_do_is_refused():
    assert "robot.plant: found 'wheel' (expected one of pendulums, " in refused(plant="wheel")
    assert "found name and plant" in refused(name="arm2", plant="arm2")
    assert "found urdf and plant" in refused(urdf="x.urdf", plant="arm2")
    lock = refused(plant="arm2", lock=["joint1"])
    assert lock == (
        "robot.lock: found joint1 with the closed-form plant 'arm2' (expected no locked joint)"
    )
    assert "robot.lock: found pendulum2" in refused(name="pendulums", lock=["pendulum2"])
    assert "robot.gravity_m_s2: found" in refused(plant="arm2", gravity_m_s2=[0, 0, -1])
    assert load_robot("arm2", lock=["joint2"]).n == 1  # the URDF can


@pytest.mark.parametrize("interconnection", ["frozen", "desired"])
def test_no_table_of_a_closed_form(interconnection):
    rows = np.zeros((3, 2))
    with pytest.raises(InputError, match="'tabulated' with the closed-form plant 'pendulums'"):
        TabulatedTerms(load_robot("pendulums"), interconnection, rows, rows, rows)


def test_home_can_be_given():
    assert load_robot(plant="arm2", home_rad=[0.1, 0.2]).home.tolist() == [0.1, 0.2]


def test_a_robot_file_that_a_closed_form_does_not_fit(tmp_path, monkeypatch):
    folder = tmp_path / "bot"
    folder.mkdir()
    monkeypatch.setattr("dftc_rt.config.robot.robots_dir", lambda: tmp_path)

    def loaded(joints, text):
        (folder / "bot.urdf").write_text(urdf_of(*[("revolute", LIMIT)] * joints))
        head = 'name = "bot"\nurdf = "bot.urdf"\nplant = "arm2"\n'
        (folder / "robot.toml").write_text(head + text)
        return refused(name="bot")

    one = '[[joint]]\nname = "j0"\narmature = 0\n'
    two = '[[joint]]\nname = "j1"\narmature = 0.2\n'
    assert "plant: 1 joints (expected 2 for the closed-form plant 'arm2')" in loaded(1, one)
    assert "armature: joint 'j1' has 0.2 with the closed-form plant 'arm2'" in loaded(2, one + two)
    assert "armature: joint 'j0' has 0.01" in loaded(2, "")  # assumed for its torque limit
