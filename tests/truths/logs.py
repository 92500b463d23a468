"""One flight of known answer as every logger would keep it, written by the libraries' own writers.

p' = -3 p + 40 roll(t - 0.04), q' = -2 q + 30 pitch(t - 0.04), r' = -r + 8 yaw(t - 0.04), φ' = p,
θ' = q: sticks move from 6 to 30 s of a log of 40 s, which rests before and after. Rates are taken
at 200 Hz, sticks at 100 Hz, attitudes at 50 Hz.
"""

import io
import resource
import struct
import tempfile
import warnings
from pathlib import Path
from types import SimpleNamespace

import nptdms
import numpy as np
from pymavlink.DFReader import DFFormat, DFReader_binary

from casid import DataWarning, StateSpace, import_log, read_log

DELAY, BEGIN, END, STEP = 0.04, 6.0, 30.0, 0.005
DAMPING, GAIN = np.array([-3.0, -2.0, -1.0]), np.array([40.0, 30.0, 8.0])
STICKS, RATES, ANGLES = ("roll", "pitch", "yaw"), ("p", "q", "r"), ("phi", "theta")
LATE = 0.02  # s, of the rates that come with the attitude


def flight(seconds=40.0, seed=0):
    """Instants every 5 ms and channels by name, in SI; gyros with noise of 0.003 rad/s."""
    rng = np.random.default_rng(seed)
    t = STEP * np.arange(round(seconds / STEP))
    flying = (t > min(BEGIN, 0.15 * seconds)) & (t < min(END, 0.75 * seconds))
    steps = rng.choice([-0.05, 0.0, 0.05], size=(int(seconds / 0.4) + 1, 3))
    steps[1::2] = -steps[: len(steps) // 2 * 2 : 2]  # doublets: attitudes come back
    u = steps[(t / 0.4).astype(int)] * flying[:, None]
    for k in range(1, len(t)):  # a stick moves within 60 ms
        u[k] = u[k - 1] + STEP / 0.06 * (u[k] - u[k - 1])
    A = np.zeros((5, 5))
    A[:3, :3], A[3, 0], A[4, 1] = np.diag(DAMPING), 1, 1
    B, C = np.vstack([np.diag(GAIN), np.zeros((2, 3))]), np.eye(5)
    late = np.vstack([np.zeros((8, 3)), u[:-8]])  # 8 samples are DELAY
    moved = StateSpace(A, B, C, np.zeros((5, 3))).simulate(t, late)
    moved[:, :3] += 0.003 * rng.standard_normal((len(t), 3))
    return t, dict(zip((*STICKS, *RATES, *ANGLES), [*u.T, *moved.T], strict=True))


# ---- ULog: header, formats, subscriptions, data ------------------------------------------------


def ulog(seconds=40.0, *, begin=100.0, lose=None, angles_late=0.0):
    """A PX4 log; rows of the sticks between ``lose`` = (from, to) [s] are missing."""
    t, x = flight(seconds)
    x |= {name: np.interp(t - angles_late, t, x[name]) for name in ANGLES}
    micro = np.round((begin + t) * 1e6).astype(np.uint64)
    cos, sin = np.cos, np.sin
    half = {name: x[name] / 2 for name in ANGLES}
    quaternion = [
        cos(half["phi"]) * cos(half["theta"]), sin(half["phi"]) * cos(half["theta"]),
        cos(half["phi"]) * sin(half["theta"]), -sin(half["phi"]) * sin(half["theta"]),
    ]  # fmt: skip
    late = round(LATE / STEP)
    rows = [(k, 0, [x[n][k] for n in RATES]) for k in range(len(t))]
    lost = (t >= lose[0]) & (t <= lose[1]) if lose else np.zeros(len(t), bool)
    rows += [(k, 1, [x[n][k] for n in STICKS]) for k in range(0, len(t), 2) if not lost[k]]
    rows += [
        (k, 2, [x["p"][max(k - late, 0)], *(each[k] for each in quaternion)])
        for k in range(0, len(t), 4)
    ]
    out = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", int(micro[0]))]
    topics = {
        "sensor_combined": "float[3] gyro_rad;",
        "actuator_controls_0": "float[3] control;",
        "vehicle_attitude": "float rollspeed;float[4] q;",
    }
    for name, fields in topics.items():
        out.append(_message("F", f"{name}:uint64_t timestamp;{fields}".encode()))
    for k, name in enumerate(topics):
        out.append(_message("A", struct.pack("<BH", 0, k) + name.encode()))
    for k, topic, values in sorted(rows):
        body = struct.pack(f"<HQ{len(values)}f", topic, int(micro[k]), *values)
        out.append(_message("D", body))
    return b"".join(out)


def _message(kind, body):
    return struct.pack("<HB", len(body), ord(kind)) + body


# ---- dataflash ---------------------------------------------------------------------------------

FORMAT = DFFormat(0x80, "FMT", 89, "BBnNZ", "Type,Length,Name,Format,Columns")
MESSAGES = {  # name: (type, letters, columns, units, multipliers)
    "UNIT": (1, "QbZ", "TimeUS,Id,Label", None, None),
    "MULT": (2, "Qbd", "TimeUS,Id,Mult", None, None),
    "FMTU": (3, "QBNN", "TimeUS,FmtType,UnitIds,MultIds", None, None),
    "IMU": (4, "QBfff", "TimeUS,I,GyrX,GyrY,GyrZ", "s#EEE", "F----"),
    "RATE": (5, "Qfff", "TimeUS,ROut,POut,YOut", "s---", "F---"),
    "ATT": (6, "Qcc", "TimeUS,Roll,Pitch", "sdd", "FBB"),
}
LEGEND = (
    ("UNIT", ord("s"), b"s"), ("UNIT", ord("d"), b"deg"), ("UNIT", ord("E"), b"rad/s"),
    ("MULT", ord("F"), 1e-6), ("MULT", ord("B"), 1e-2), ("MULT", ord("-"), 0.0),
    *(("FMTU", k, u.encode(), f.encode()) for k, _, _, u, f in MESSAGES.values() if u),
)  # fmt: skip


def dataflash(seconds=40.0):
    """An ArduPilot log: rates in rad/s of two units, attitudes in hundredths of degrees."""
    t, x = flight(seconds)
    writer = SimpleNamespace(formats={0x80: FORMAT})
    forms = {n: DFFormat(k, n, 0, f, c) for n, (k, f, c, _, _) in MESSAGES.items()}
    out = [DFReader_binary.make_format_msgbuf(writer, form) for form in (FORMAT, *forms.values())]

    def add(name, *values):
        out.append(DFReader_binary.make_msgbuf(writer, forms[name], values))

    for name, *values in LEGEND:
        add(name, 0, *values)
    for k, now in enumerate(np.round((1000 + t) * 1e6).astype(int).tolist()):
        rates = [x[name][k] for name in RATES]
        add("IMU", now, 0, *rates)
        if k % 2 == 0:
            add("RATE", now, *(x[name][k] for name in STICKS))
            add("IMU", now + 100, 1, *rates)
        if k % 4 == 0:
            hundredths = np.round(np.degrees([x[name][k] for name in ANGLES]) * 100)
            add("ATT", now, *hundredths.astype(int).tolist())
    return b"".join(out)


def dataflash_text(seconds=40.0):
    """The same log as pymavlink converts it to text: values scaled as their letters say."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight.bin"
        path.write_bytes(dataflash(seconds))
        lines = []
        with DFReader_binary(str(path), zero_time_base=True) as log:
            while (row := log.recv_msg()) is not None:
                values = (getattr(row, name) for name in row.fmt.columns)
                lines.append(", ".join(map(str, (row.get_type(), *values))))
    return "\n".join(lines).encode() + b"\n"


# ---- TDMS --------------------------------------------------------------------------------------


def tdms(seconds=40.0):
    """A LabVIEW log: sticks beside a column of times, rates and attitudes in deg as waveforms."""
    t, x = flight(seconds)
    wave = {"unit_string": "deg/s", "wf_increment": STEP, "wf_start_offset": 0.0}
    slow = {"unit_string": "deg", "wf_increment": 4 * STEP, "wf_start_offset": 0.0}
    channels = [nptdms.ChannelObject("sticks", "Time", t[::2])]
    channels += [nptdms.ChannelObject("sticks", name, x[name][::2]) for name in STICKS]
    channels += [nptdms.ChannelObject("gyros", n, np.degrees(x[n]), wave) for n in RATES]
    channels += [nptdms.ChannelObject("angles", n, np.degrees(x[n][::4]), slow) for n in ANGLES]
    channels += [nptdms.ChannelObject("gyros", "without time", np.arange(5.0))]
    file = io.BytesIO()
    with nptdms.TdmsWriter(file) as writer:
        writer.write_segment(channels)
    return file.getvalue()


WRITERS = {
    "flight.ulg": ulog,
    "flight.bin": dataflash,
    "flight.tdms": tdms,
    "flight.log": dataflash_text,
}


def damaged(data, rng):
    """A log with a few bytes flipped, cut out, copied or put in."""
    data = bytearray(data)
    for _ in range(rng.integers(1, 7)):
        a = int(rng.integers(0, len(data) + 1)) if rng.random() < 0.5 else int(rng.integers(0, 600))
        a = min(a, len(data))
        b = min(len(data), a + int(rng.integers(0, 40)))
        match rng.integers(0, 5):
            case 0:
                del data[a:b]
            case 1:
                data[a:a] = data[a:b]
            case 2:
                data[a:b] = rng.bytes(b - a)
            case 3:
                data[a:b] = b"\xff" * (b - a)
            case _:
                data[a:b] = b"\0" * (b - a)
    return bytes(data)


def outcome(path, data, read=read_log):
    """What is read, or the refusal; anything else gets through."""
    path.write_bytes(data)
    try:
        return read(path)
    except ValueError as error:
        said = str(error)
    assert str(path) in said
    return said


def drafted(path):
    """The study of a log, which is forgotten again."""
    with tempfile.TemporaryDirectory() as folder:
        return import_log(path, folder)


def fuzz(many=10_000, seed=1, more=200):
    """Import damaged logs of at most 64 kB, as text 256; none may take ``more`` MB."""
    warnings.simplefilter("ignore", DataWarning)
    rng = np.random.default_rng(seed)
    sound = {name: write(6.2) for name, write in WRITERS.items()}
    assert max(map(len, sound.values())) < 2**18
    refused = 0
    with tempfile.TemporaryDirectory() as folder:
        for name, data in sound.items():  # what is imported late is no memory of a log
            outcome(Path(folder) / name, data, drafted)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        for k in range(many):
            name = list(sound)[k % len(sound)]
            data = damaged(sound[name], rng)
            refused += isinstance(outcome(Path(folder) / name, data, drafted), str)
        taken = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    assert taken < more, f"{taken:.0f} MB"
    assert 0.1 * many < refused < 0.9 * many
    return refused, taken
