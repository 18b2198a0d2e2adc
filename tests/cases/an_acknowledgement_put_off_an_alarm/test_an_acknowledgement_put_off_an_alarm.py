"""Acknowledge, pressed while an alarm waited for its on-delay, began that delay anew: pressed often, it never came."""

from gateway.machine.alarms.states import Alarm, AlarmCondition, AlarmState, acknowledge, new_alarm, step

HOT = AlarmCondition("over limit T", "T", bit=0, limit=80.0, on_delay=3.0, off_delay=3.0)


def pressed(alarm: Alarm, second: int) -> Alarm:
    """The alarm after a rising edge of its bit."""
    return acknowledge({HOT.name: HOT}, {HOT.name: alarm}, before=0, bits=1, now=float(second), by="PLC")[HOT.name]


def test_an_alarm_comes_after_its_delay_however_often_acknowledge_is_pressed() -> None:
    alarm = new_alarm(HOT, 0.0)
    for second in range(10):
        alarm = pressed(step(HOT, alarm, 90.0, float(second)), second)
        assert alarm.active == (second >= 3)


def test_it_returns_after_its_delay_too() -> None:
    alarm = step(HOT, step(HOT, new_alarm(HOT, 0.0), 90.0, 0.0), 90.0, 3.0)
    for second in range(4, 12):
        alarm = pressed(step(HOT, alarm, 20.0, float(second)), second)
    assert alarm.state is AlarmState.NORMAL and alarm.since == 7.0
