"""Your own PD controller for the emulated Panda, in python-can: docs/drives.md."""

import json
import math
import signal
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import can

DFTC = Path(sys.executable).with_name("dftc")
RIG = ["rig", "panda_shoulder_loss", "--set", "fault=[]", "--lockstep", "--json", "--bus", "unix"]
NODES = {1: "can0", 2: "can0", 3: "can0", 4: "can1", 5: "can1", 6: "can2", 7: "can2"}
MOVE = {1: 0.4, 2: 0.2, 3: -0.3, 4: 0.3, 5: 0.5, 6: -0.3, 7: 0.6}  # rad
KP = {1: 3000, 2: 4000, 3: 2000, 4: 3000, 5: 200, 6: 200, 7: 60}  # Nm/rad
KD, CYCLES, OFF = 0.04, 2500, 0.02  # s, times KP; of 1 ms; most that is forgiven, rad
BARRIER = 0x1FFFFFFE  # ends our share of a cycle, and the rig's


def send(bus, can_id, data=b""):
    bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=can_id > 0x7FF), 1.0)


def sdo(bus, node, index, sub, value=0, size=0):  # write that many bytes, or read
    command = 0x23 | (4 - size) << 2 if size else 0x40
    send(bus, 0x600 + node, struct.pack("<BHBI", command, index, sub, value))
    answer = next(frame for frame in bus if frame.arbitration_id == 0x580 + node)
    return struct.unpack_from("<I", answer.data, 4)[0]


def control(buses):  # returns where the joints should be, rad
    counts, unit, seen = {}, {}, {}  # per rad; Nm of a per mille; (position, velocity), counts
    for n, name in NODES.items():
        sdo(buses[name], n, 0x6060, 0, 10, 1)  # mode: cyclic synchronous torque
        sdo(buses[name], n, 0x6072, 0, 3000, 2)  # at most 3000 per mille of the rated torque
        for index, cob_id in ((0x1402, 0x400 + n), (0x1802, 0x40000380 + n)):  # RPDO3, TPDO3
            sdo(buses[name], n, index, 2, 1, 1)  # with every SYNC
            sdo(buses[name], n, index, 1, cob_id, 4)  # valid
        counts[n] = sdo(buses[name], n, 0x608F, 1) / math.tau  # Panda's gear, 6091h, is 1
        unit[n] = sdo(buses[name], n, 0x6076, 0) * 1e-6
        send(buses[name], 0, bytes([1, n]))  # NMT: start

    def cycle(word, torque):
        for n, name in NODES.items():
            mille = max(-3000, min(round(torque[n] / unit[n]), 3000)) if torque else 0
            send(buses[name], 0x400 + n, struct.pack("<Hh", word, mille))
        for bus in buses.values():
            send(bus, 0x080)  # SYNC: the torque acts, and every drive answers
            send(bus, BARRIER, bytes(8))
        for bus in buses.values():
            while (frame := bus.recv()).arbitration_id != BARRIER:
                if frame.dlc == 8:  # TPDO3
                    seen[frame.arbitration_id - 0x380] = struct.unpack("<ii", frame.data)

    for word in (6, 7, 15, 15):  # shutdown, switch on, enable operation: the brakes open
        cycle(word, {})
    start = {n: seen[n][0] / counts[n] for n in NODES}
    for k in range(CYCLES):
        share = 0.5 - 0.5 * math.cos(math.pi * min(k / (0.6 * CYCLES), 1.0))
        error = {n: start[n] + share * MOVE[n] - seen[n][0] / counts[n] for n in NODES}
        cycle(15, {n: KP[n] * (error[n] - KD * seen[n][1] / counts[n]) for n in NODES})
    cycle(0, {})  # disable voltage: the brakes close
    return [start[n] + MOVE[n] for n in NODES]


with tempfile.TemporaryDirectory() as folder:
    rig = subprocess.Popen([DFTC, *RIG, "--bus-dir", folder], stdout=-1, stderr=-1)
    while b"Ctrl-C ends" not in (line := rig.stderr.readline()):  # then the buses are there
        line or sys.exit("the rig did not start")
    buses = {name: can.Bus(name, "dftc", bus_dir=folder) for name in set(NODES.values())}
    wanted = control(buses)
    _ = [bus.shutdown() for bus in buses.values()]
    rig.send_signal(signal.SIGINT)
    joints = json.loads(rig.communicate()[0])["joints"]
for target, (name, true) in zip(wanted, joints.items(), strict=True):
    print(f"{name} should be at {target:.4f} rad and is at {true['q_rad']:.4f}")
    _ = abs(true["q_rad"] - target) < OFF or sys.exit("too far off")
