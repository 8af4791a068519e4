"""One joint of the emulated Panda, moved with the canopen library alone: docs/drives.md."""

import json
import logging
import math
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import canopen
from canopen.profiles.p402 import BaseNode402

DFTC = Path(sys.executable).with_name("dftc")
RIG = [DFTC, "rig", "panda_shoulder_loss", "--json", "--bus", "unix", "--set", "fault=[]"]
# 200 cycles a second is what an ordinary Linux keeps; a stall of half a second is forgiven.
RIG += ["--set", "executor.rate_hz=200", "--set", "rig.drive.watchdog_s=0.5"]
EDS = Path(__file__).parents[1] / "dftc_rt" / "drives" / "cia402" / "dftc402.eds"
PERIOD, SECONDS, MOVE, OFF = 0.005, 3.0, 0.5, 0.02  # s, s, rad, rad
KP, KD = 40.0, 14.0  # Nm/rad, Nm s/rad: joint 1 turns about the vertical and carries no weight


logging.getLogger("canopen").setLevel(logging.ERROR)  # it would map the mode into a PDO too


def control(network):
    """Move joint 1, give it to its brake, and return where it should be, rad."""
    node = network.add_node(BaseNode402(1, str(EDS)))
    node.nmt.state = "PRE-OPERATIONAL"
    node.setup_402_state_machine()  # reads the PDOs: controlword in RPDO1, statusword in TPDO1
    command, feedback = node.rpdo[3], node.tpdo[3]  # with the torque; position and velocity
    for pdo in (command, feedback):
        pdo.trans_type, pdo.enabled = 1, True  # with every SYNC
        pdo.save()
    turn = node.sdo["Position encoder resolution"]["Encoder increments"].raw  # the gear is 1
    rated = node.sdo["Motor rated torque"].raw * 1e-3  # Nm
    node.nmt.state = "OPERATIONAL"
    node.op_mode = "CYCLIC SYNCHRONOUS TORQUE"
    node.state = "OPERATION ENABLED"  # the brake opens
    print(f"node 1: {node.state}, {node.op_mode}, {turn} counts a turn, {rated:.0f} Nm rated")
    start = None
    begun = time.monotonic()
    while (t := time.monotonic() - begun) < SECONDS:
        network.sync.transmit()  # the drive puts the last torque into force, and answers
        if feedback.wait_for_reception(0.5) is None:
            sys.exit("no answer to SYNC")
        q = feedback["Position actual value"].raw * math.tau / turn
        v = feedback["Velocity actual value"].raw * math.tau / turn
        start = q if start is None else start
        share = 0.5 - 0.5 * math.cos(math.pi * min(t / 1.5, 1.0))
        torque = KP * (start + share * MOVE - q) - KD * v
        command["Controlword"].raw = 15
        command["Target torque"].raw = round(1000 * max(-1.0, min(torque / rated, 1.0)))
        command.transmit()
        time.sleep(PERIOD - (time.monotonic() - begun) % PERIOD)
    node.state = "SWITCH ON DISABLED"  # the brake closes
    return start + MOVE


with tempfile.TemporaryDirectory() as folder:
    rig = subprocess.Popen([*RIG, "--bus-dir", folder], stdout=-1, stderr=-1)
    while b"Ctrl-C ends" not in (line := rig.stderr.readline()):  # then the buses are there
        line or sys.exit("the rig did not start")
    with canopen.Network() as network:
        network.connect(interface="dftc", channel="can0", bus_dir=folder)
        target = control(network)
    rig.send_signal(signal.SIGINT)
    true = json.loads(rig.communicate()[0])["joints"]["panda_joint1"]["q_rad"]
print(f"panda_joint1 should be at {target:.4f} rad and is at {true:.4f}")
if abs(true - target) > OFF:
    sys.exit("too far off")
