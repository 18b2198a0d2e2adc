"""What a signal may be to an effect, and the plant's signal that is it."""

from sim.effects.kind import Parameter, Role

CURRENT = Role("current", "Assorbimento")
TORQUE = Role("torque", "Coppia")
SPEED = Role("speed", "Differenziale")
VIBRATION = Role("vibration", "LivelloVibrazioni")
PUMP = Role("pump", "MarciaPmpFango")
FEED = Role("feed", "TFango")
AMBIENT = Role("ambient", "TAmbiente")
SINK = Role("sink", "")

SETTABLE = (CURRENT.name, SPEED.name, PUMP.name)
"""Roles whose signals a person sets, the load first; what a room, a feed or a vibration has is theirs."""

TO_SCALE_OF_X = {
    "scale": Parameter(unit="1", positive=True, default=1.0, rescaled="scaled"),
    "shift": Parameter(unit="degC", default=0.0, rescaled="mapped"),
}
"""Parameters of kinds that read a temperature: in X's scale it is `scale` times the signal plus `shift`."""
