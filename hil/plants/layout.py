"""Rows of the two arrays that the plant's kernels share; a column is a joint."""

from __future__ import annotations

from typing import Final

# State, (N_STATE, n). The first five are what others read.
COMMAND: Final = 0  # torque the motor is told, Nm
MOTOR: Final = 1  # what its current says: behind the lag, times the nominal constant, Nm
APPLIED: Final = 2  # torque it does give, Nm
RHO: Final = 3  # effectiveness
FAULT: Final = 4  # 1.0 while a fault is active
LAGGED: Final = 5  # behind the lag of a fault, Nm
HELD: Final = 6  # what a stuck motor gives, Nm
HOLDING: Final = 7  # 1.0 once it is held
BIAS: Final = 8  # what faults do at this instant: torque added, Nm,
CEILING: Final = 9  # most torque that comes out, Nm,
DEAD_ZONE: Final = 10  # torque that is swallowed, Nm,
LAG: Final = 11  # further lag, s,
STUCK: Final = 12  # 1.0 where the torque is stuck,
FRICTION: Final = 13  # friction over what it is without the fault
BRISTLE: Final = 14  # deflection of the bristles, rad
DECAY: Final = 15  # over this substep: bristle = DECAY bristle + SLIP velocity
SLIP: Final = 16  # s
ADDED: Final = 17  # inertia that stands for friction at the substep's end, kg m^2
N_STATE: Final = 18

# Parameters, (N_PARAMETERS, n).
TORQUE_LIMIT: Final = 0  # Nm
TORQUE_CONSTANT: Final = 1  # true over nominal
VISCOUS: Final = 2  # Nm s/rad
COULOMB: Final = 3  # Nm, without load
STATIC: Final = 4  # static over Coulomb friction
STRIBECK: Final = 5  # Stribeck velocity, rad/s
STIFFNESS: Final = 6  # of the bristles, Nm/rad; 0: viscous and Coulomb friction alone
LOAD: Final = 7  # Coulomb friction is this much larger at the torque limit
N_PARAMETERS: Final = 8
