"""CiA 402-2, table of transitions, written out: every state under every command."""

from __future__ import annotations

from each import each
from hypothesis import given
from hypothesis import strategies as st

from sim_drivers.canopen.state import State, StateMachine

NRTSO, SOD, RTSO, SO, OE, QSA, FRA, FAULT = State
SHUTDOWN, SWITCH_ON, ENABLE, DISABLE_VOLTAGE, QUICK_STOP = 0x06, 0x07, 0x0F, 0x00, 0x02

TABLE = {  # state: (shutdown, switch on = disable operation, enable operation, disable voltage, quick stop)
    NRTSO: (NRTSO, NRTSO, NRTSO, NRTSO, NRTSO),
    SOD: (RTSO, SOD, SOD, SOD, SOD),
    RTSO: (RTSO, SO, OE, SOD, SOD),
    SO: (RTSO, SO, OE, SOD, SOD),
    OE: (RTSO, SO, OE, SOD, QSA),
    QSA: (QSA, QSA, QSA, SOD, QSA),
    FRA: (FRA, FRA, FRA, FRA, FRA),
    FAULT: (FAULT, FAULT, FAULT, FAULT, FAULT),
}
WORDS = {NRTSO: 0x210, SOD: 0x250, RTSO: 0x231, SO: 0x233, OE: 0x237, QSA: 0x217, FRA: 0x21F, FAULT: 0x218}


def machine_in(state: State, option: int = 2) -> StateMachine:
    machine = StateMachine()
    machine.state, machine.quick_stop_option = state, option
    return machine


@each("state", State)
def test_every_state_under_every_command(state: State) -> None:
    for word, expected in zip((SHUTDOWN, SWITCH_ON, ENABLE, DISABLE_VOLTAGE, QUICK_STOP), TABLE[state], strict=True):
        machine = machine_in(state)
        machine.control(word)
        assert machine.state is expected, (state, hex(word))
    assert machine_in(state).statusword == WORDS[state]


@given(st.sampled_from(State), st.integers(0, 0xFFFF))
def test_bits_that_belong_to_the_mode_change_no_state(state: State, word: int) -> None:
    plain, other = machine_in(state), machine_in(state)
    plain.control(word & 0x8F)
    other.control(word)
    assert plain.state is other.state


def test_a_fault_is_reset_by_an_edge_only_and_enables_nothing() -> None:
    machine = machine_in(OE)
    machine.fault()
    assert machine.state is FRA
    machine.control(0x80)
    assert machine.state is FRA
    machine.stopped()
    assert machine.state is FAULT
    machine.control(0x80)  # the bit is still up: no edge
    assert machine.state is FAULT
    machine.control(0x00)
    machine.control(0x80 | ENABLE)
    assert machine.state is SOD
    machine.control(ENABLE)
    assert machine.state is SOD


@each(("option", "end"), [(1, SOD), (2, SOD), (5, QSA), (6, QSA)])
def test_how_a_quick_stop_ends(option: int, end: State) -> None:
    machine = machine_in(OE, option)
    machine.control(QUICK_STOP)
    assert machine.state is QSA
    machine.stopped()
    assert machine.state is end
    machine.control(ENABLE)
    assert machine.state is (OE if end is QSA else SOD)


def test_a_quick_stop_without_a_ramp() -> None:
    machine = machine_in(OE, 0)
    machine.control(QUICK_STOP)
    assert machine.state is SOD


def test_power_on() -> None:
    machine = StateMachine()
    machine.control(SHUTDOWN)
    assert machine.state is NRTSO
    machine.initialised()
    assert machine.state is SOD


@given(st.lists(st.integers(0, 0xFFFF), max_size=30))
def test_operation_is_only_enabled_by_the_command(words: list[int]) -> None:
    machine = machine_in(FAULT)
    for word in words:
        before = machine.state
        machine.control(word)
        if machine.state is OE is not before:
            assert word & 0x8F == ENABLE
            assert before in (RTSO, SO)
