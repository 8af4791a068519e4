"""Your own PD controller for the emulated Panda, in plain python-can: docs/drives.md."""

import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import can

RIG = [Path(sys.executable).with_name("dftc"), "rig", "panda_shoulder_loss", "--set", "fault=[]"]
BUS = {1: "can0", 2: "can0", 3: "can0", 4: "can1", 5: "can1", 6: "can2", 7: "can2"}  # by node
MOVE = {1: 0.4, 2: 0.2, 3: -0.3, 4: 0.3, 5: 0.5, 6: -0.3, 7: 0.6}  # rad
KP = {1: 3000, 2: 4000, 3: 2000, 4: 3000, 5: 200, 6: 200, 7: 60}  # Nm/rad
KD, CYCLES, COUNT, BARRIER = 0.04, 2500, 6.2831853 / 524288, 0x1FFFFFFE  # s, times KP; 1 ms; rad


def send(n, can_id, layout="", *values):  # on the bus of node n
    buses[BUS[n]].send(can.Message(0.0, can_id, can_id > 0x7FF, data=struct.pack(layout, *values)))


def sdo(n, command, index, sub=0, value=0):  # write 1, 2, 4 bytes: 2Fh, 2Bh, 23h; read: 40h
    send(n, 0x600 + n, "<BHBI", command, index, sub, value)
    answer = next(frame for frame in buses[BUS[n]] if frame.arbitration_id == 0x580 + n)
    return struct.unpack_from("<I", answer.data, 4)[0]


def cycle(word, torque):  # controlword and torques, Nm; returns positions and velocities, rad
    for n in BUS:
        send(n, 0x400 + n, "<Hh", word, round(torque.get(n, 0) / unit[n]))
    for n in (1, 4, 6):  # one of each bus
        send(n, 0x080)  # SYNC: the torque acts, and every drive answers
        send(n, BARRIER, "<Q", 0)  # ends our share of the cycle, and then the rig's
    for bus in buses.values():
        while (frame := bus.recv()).arbitration_id != BARRIER:
            seen[frame.arbitration_id] = frame.data
    return {n: [COUNT * x for x in struct.unpack("<ii", seen[0x380 + n])] for n in BUS}


with tempfile.TemporaryDirectory() as folder:
    rig = subprocess.Popen([*RIG, "--lockstep", "--bus", "unix", "--bus-dir", folder], stderr=-1)
    next(line for line in rig.stderr if b"Ctrl-C ends" in line)  # then the buses are there
    buses = {name: can.Bus(name, "dftc", bus_dir=folder) for name in set(BUS.values())}
    unit, seen = {n: sdo(n, 0x40, 0x6076) * 1e-6 for n in BUS}, {}  # Nm of a per mille; frames
    for n in BUS:
        sdo(n, 0x2F, 0x6060, 0, 10)  # mode: cyclic synchronous torque
        sdo(n, 0x2B, 0x6072, 0, 3000)  # at most 3000 per mille of the rated torque
        for index, cob_id in ((0x1402, 0x400 + n), (0x1802, 0x40000380 + n)):  # RPDO3, TPDO3
            sdo(n, 0x2F, index, 2, 1)  # with every SYNC
            sdo(n, 0x23, index, 1, cob_id)  # valid
        send(n, 0, "BB", 1, n)  # NMT: start
    start = now = [cycle(word, {}) for word in (6, 7, 15, 15)][-1]  # enabled: the brakes open
    for k, word in enumerate([15] * CYCLES + [0]):  # at last disable voltage: the brakes close
        error = {n: start[n][0] + MOVE[n] * min(2 * k / CYCLES, 1) - now[n][0] for n in BUS}
        now = cycle(word, {n: KP[n] * (error[n] - KD * now[n][1]) for n in BUS})
    _ = [bus.shutdown() for bus in buses.values()]
    rig.terminate()
for n in BUS:
    print(f"joint{n} should be at {start[n][0] + MOVE[n]:.4f} rad and is at {now[n][0]:.4f}")
sys.exit("too far off" if max(map(abs, error.values())) > 0.02 else 0)
