from dftc_rt.bus.bits import worst_bits
from dftc_rt.drives.cia402 import mapping
from dftc_rt.drives.cia402.objects import SYNC_COUNTER_OVERFLOW, TORQUE_ACTUAL_EVERY


def test_rpdo1_is_remapped_as_cia_301_says() -> None:
    # Destroy (bit 31), type, count 0, entries, count, create. Entry: index, sub, bits.
    assert list(mapping.writes(3, 0))[:6] == [
        (0x1400, 1, 0x8000_0203),
        (0x1400, 2, 1),
        (0x1600, 0, 0),
        (0x1600, 1, 0x6040_0010),
        (0x1600, 2, 0x6071_0010),
        (0x1600, 0, 2),
    ]
    assert list(mapping.writes(3, 0))[6] == (0x1400, 1, 0x0000_0203)


def test_tpdos_carry_what_the_codec_reads() -> None:
    writes = {(index, sub): value for index, sub, value in mapping.writes(3, 1)}
    assert writes[0x1A00, 1] == 0x6064_0020
    assert writes[0x1A00, 2] == 0x606C_0020
    assert writes[0x1A01, 1] == 0x6041_0010
    assert writes[0x1A01, 2] == 0x6061_0008
    assert writes[0x1A02, 1] == 0x6077_0010
    assert [writes[0x1800 + k, 2] for k in range(3)] == [1, 255, 10]
    assert [writes[0x1800 + k, 1] for k in range(3)] == [0x4000_0183, 0x4000_0283, 0x4000_0383]


def test_drives_of_a_bus_take_turns() -> None:
    starts = [
        next(value for index, sub, value in mapping.writes(k + 1, k) if (index, sub) == (0x1802, 6))
        for k in range(TORQUE_ACTUAL_EVERY)
    ]
    assert len(set(starts)) == TORQUE_ACTUAL_EVERY
    assert min(starts) == 1  # 0 would mean: no start value
    assert SYNC_COUNTER_OVERFLOW % TORQUE_ACTUAL_EVERY == 0  # or the turns would collide


def test_three_joints_fit_a_millisecond_at_worst() -> None:
    sync, command, answer, slow, status, heartbeat = map(worst_bits, (1, 4, 8, 2, 3, 1))
    busiest = sync + 3 * (command + answer) + slow
    assert busiest + heartbeat <= 900
    assert busiest + status <= 1000  # a status change still fits its cycle
