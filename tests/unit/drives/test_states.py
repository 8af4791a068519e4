"""The state machine against the figure of CiA 402-2, and against canopen's copy of it."""

import pytest
from canopen.profiles.p402 import State402
from hypothesis import given
from hypothesis import strategies as st

from dftc_rt.drives.cia402 import states as s

# Read off the figure by hand: for each state, where each command leads.
#                            disable  quick             switch  enable
#                            voltage  stop    shutdown  on      operation
FIGURE = {
    s.NOT_READY_TO_SWITCH_ON: [s.NOT_READY_TO_SWITCH_ON] * 5,
    s.SWITCH_ON_DISABLED: [
        s.SWITCH_ON_DISABLED, s.SWITCH_ON_DISABLED, s.READY_TO_SWITCH_ON,
        s.SWITCH_ON_DISABLED, s.SWITCH_ON_DISABLED,
    ],
    s.READY_TO_SWITCH_ON: [
        s.SWITCH_ON_DISABLED, s.SWITCH_ON_DISABLED, s.READY_TO_SWITCH_ON,
        s.SWITCHED_ON, s.OPERATION_ENABLED,
    ],
    s.SWITCHED_ON: [
        s.SWITCH_ON_DISABLED, s.SWITCH_ON_DISABLED, s.READY_TO_SWITCH_ON,
        s.SWITCHED_ON, s.OPERATION_ENABLED,
    ],
    s.OPERATION_ENABLED: [
        s.SWITCH_ON_DISABLED, s.QUICK_STOP_ACTIVE, s.READY_TO_SWITCH_ON,
        s.SWITCHED_ON, s.OPERATION_ENABLED,
    ],
    s.QUICK_STOP_ACTIVE: [
        s.SWITCH_ON_DISABLED, s.QUICK_STOP_ACTIVE, s.QUICK_STOP_ACTIVE,
        s.QUICK_STOP_ACTIVE, s.QUICK_STOP_ACTIVE,
    ],
    s.FAULT_REACTION_ACTIVE: [s.FAULT_REACTION_ACTIVE] * 5,
    s.FAULT: [s.FAULT] * 5,
}  # fmt: skip
CONTROLWORDS = [0x0000, 0x0002, 0x0006, 0x0007, 0x000F]


@pytest.mark.parametrize("state", FIGURE)
@pytest.mark.parametrize("command", range(5))
def test_every_state_and_command(state: int, command: int) -> None:
    assert s.next_state(state, CONTROLWORDS[command], 0, 2) == FIGURE[state][command]


def test_each_transition_number_is_in_the_table() -> None:
    # 0, 1 happen at power-on; 13, 14 are the fault's and the drive's own.
    assert {row[0] for row in s.TRANSITIONS} == {2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 15, 16}


def test_quick_stop_is_left_upwards_with_options_5_to_8_alone() -> None:
    for option in range(9):
        after = s.next_state(s.QUICK_STOP_ACTIVE, 0x0F, 0, option)
        assert after == (s.OPERATION_ENABLED if option >= 5 else s.QUICK_STOP_ACTIVE)


def test_fault_is_reset_by_the_rising_edge_of_bit_7_alone() -> None:
    assert s.next_state(s.FAULT, 0x80, 0x00, 2) == s.SWITCH_ON_DISABLED
    assert s.next_state(s.FAULT, 0x80, 0x80, 2) == s.FAULT
    assert s.next_state(s.FAULT, 0x0F, 0x00, 2) == s.FAULT
    assert s.next_state(s.FAULT_REACTION_ACTIVE, 0x80, 0x00, 2) == s.FAULT_REACTION_ACTIVE


@given(st.integers(0, 0xFFFF))
def test_bits_that_are_no_command_do_not_matter(word: int) -> None:
    assert s.command_of(word) == s.command_of(word & 0x0F)


NAMES = {name.upper(): number for number, name in enumerate(s.STATE_NAMES)}


def test_statusword_patterns_are_canopens() -> None:
    for name, (mask, bits) in State402.SW_MASK.items():
        assert int(s.STATE_BITS[NAMES[name]]) & mask == bits
        assert s.state_of(bits) == NAMES[name]


@given(st.integers(0, 0xFFFF))
def test_any_statusword_reads_as_canopen_reads_it(word: int) -> None:
    expected = {
        NAMES[name] for name, (mask, bits) in State402.SW_MASK.items() if word & mask == bits
    }
    if expected:
        assert s.state_of(word) in expected
        assert len(expected) == 1
    else:
        assert s.state_of(word) == s.NOT_READY_TO_SWITCH_ON


def test_transitions_are_canopens() -> None:
    for (start, end), controlword in State402.TRANSITIONTABLE.items():
        if start in ("START", "NOT READY TO SWITCH ON", "FAULT REACTION ACTIVE"):
            continue  # the drive takes these by itself
        assert s.next_state(NAMES[start], controlword, 0, 6) == NAMES[end]
