"""The scripts that fly a card, run against stand-ins for the autopilots."""

import ast
import hashlib
import sys
from types import ModuleType, SimpleNamespace

import lupa.lua54
import numpy as np
import pytest

from casid.design.injection import ardupilot_script, is_own, px4_script
from casid.errors import DataWarning

T = 0.04 * np.arange(6)
R = {"lat": np.array([0, 0.1, 0.1, -0.2, 0, 0.0]), "ped": np.array([0, 0, 0.5, 0.5, 0, 0.0])}
CARD = "t,lat\n0.0,0.0\n0.04,0.1\n"

AUTOPILOT = """
overrides, texts, now, switch, armed, lost = {}, {}, 0, 0, true, nil
local moment = {}
moment.__index = moment
moment.__sub = function(a, b) return setmetatable({ms = a.ms - b.ms}, moment) end
function moment.toint(a) return a.ms end
function millis() return setmetatable({ms = now}, moment) end
local centre = {1510, 1480, 1600, 1495}
rc = {}
function rc:get_pwm(n) if n ~= lost then return centre[n] end end
function rc:get_aux_cached(option) if option == 300 then return switch end end
function rc:get_channel(n) return {set_override = function(_, pwm) overrides[n] = pwm end} end
ends = {RC1_MIN = 1310, RC1_MAX = 1900, RC4_MIN = 1100, RC4_MAX = 1695}
param = {get = function(_, name) return ends[name] end}
arming = {is_armed = function() return armed end}
gcs = {send_text = function(_, level, text) texts[#texts + 1] = text end}
"""


@pytest.fixture
def autopilot():
    """Lua 5.4 without a language of its own beside it, some of ArduPilot's names, the script."""
    lua = lupa.lua54.LuaRuntime()
    lua.execute(AUTOPILOT)
    channels = {"lat": (1, 500.0), "ped": (4, 400.0)}
    lua.execute(ardupilot_script(T, R, channels, "steps", CARD))
    return lua.globals()


def after(autopilot, now):
    """Overrides of both channels after the script has run at a time [ms]."""
    autopilot.now = now
    autopilot.update()
    return autopilot.overrides[1], autopilot.overrides[4]


def test_the_sticks_of_ardupilot_follow_the_card_from_where_they_were(autopilot):
    assert after(autopilot, 1000) == (None, None)
    autopilot.switch = 2
    after(autopilot, 2000)  # begins
    assert after(autopilot, 2001) == (1510, 1495)
    assert after(autopilot, 2041) == (1560, 1495)
    assert after(autopilot, 2099) == (1560, 1695)
    assert after(autopilot, 2120) == (1410, 1695)
    assert after(autopilot, 2240) == (0, 0)  # flown: the pilot's again
    assert after(autopilot, 2300) == (0, 0)
    assert list(autopilot.texts.values())[-1] == "card: flown"


@pytest.mark.parametrize("cause", ["switch", "armed"])
def test_the_pilot_has_the_sticks_at_once_when_the_switch_goes_back(autopilot, cause):
    autopilot.switch = 2
    after(autopilot, 0)
    assert after(autopilot, 130) == (1410, 1695)
    setattr(autopilot, cause, 0 if cause == "switch" else False)
    assert after(autopilot, 131) == (0, 0)


def test_a_lost_channel_starts_nothing(autopilot):
    autopilot.switch, autopilot.lost = 2, 4
    after(autopilot, 0)
    assert after(autopilot, 100) == (None, None)
    assert "card: no RC input 4" in list(autopilot.texts.values())


@pytest.mark.parametrize(
    ("end", "value", "words"),
    [
        ("RC1_MIN", 1411, "card: RC1 to 1410..1560, has 1411..1900"),
        ("RC4_MAX", 1694, "card: RC4 to 1495..1695, has 1100..1694"),
        ("RC4_MAX", None, "card: no RC4_MIN, RC4_MAX"),
    ],
)
def test_a_card_that_no_rc_channel_can_follow_from_trim_is_not_begun(autopilot, end, value, words):
    autopilot.switch, autopilot.ends[end] = 2, value
    after(autopilot, 0)
    assert after(autopilot, 100) == (None, None)
    assert words in list(autopilot.texts.values())


class Link:
    """What the script for PX4 uses of a link: its clock, messages and heartbeats."""

    def __init__(self, changes_at=np.inf, interrupted_at=np.inf):
        self.others, self.texts, self.interrupted_at = 0, [], interrupted_at
        self.now, self.sent, self.changes_at, self.mav = 0.0, [], changes_at, self

    def manual_control_send(self, target, *sticks):
        assert target == 1
        self.sent.append((round(self.now, 3), *sticks))

    def recv_match(self, *, type, blocking):  # noqa: ARG002 - pymavlink's names
        self.others = (self.others + 1) % 3  # of three heartbeats one is the autopilot's
        mode = 7 if self.now < self.changes_at else 3
        if self.others:  # a gimbal's, whose modes are its own
            return SimpleNamespace(
                custom_mode=100 + self.others, get_srcSystem=lambda: 1,
                get_srcComponent=lambda: 154,
            )  # fmt: skip
        return SimpleNamespace(
            custom_mode=mode, get_srcSystem=lambda: 1, get_srcComponent=lambda: 1
        )

    def wait(self, seconds):
        self.now += seconds
        if self.now > self.interrupted_at:
            self.interrupted_at = np.inf
            raise KeyboardInterrupt


@pytest.fixture
def program(monkeypatch):
    """Names of the script for PX4, with nothing of pymavlink."""
    monkeypatch.setitem(sys.modules, "pymavlink", ModuleType("pymavlink"))
    sys.modules["pymavlink"].mavutil = None
    names = {"__name__": "inject"}
    axes = {"lat": ("y", 1000), "ped": ("r", 1800.0)}
    exec(compile(px4_script(T, R, axes, "steps", CARD), "i", "exec"), names)
    return SimpleNamespace(**names)


def fly(program, link, **trim):
    card = {"t": T.tolist()} | {name: r.tolist() for name, r in R.items()}
    centre = {"x": 20.0, "y": 0.0, "z": 430.0, "r": 100.0} | trim
    return program.fly(
        link, card, centre, clock=lambda: link.now, wait=link.wait, say=link.texts.append
    )


def test_px4_gets_the_card_as_a_joystick_within_its_range(program):
    link = Link()
    assert fly(program, link)
    assert link.sent[0] == (0.0, 20, 0, 430, 100, 0)
    assert (0.06, 20, 100, 430, 100, 0) in link.sent
    assert (0.14, 20, -200, 430, 1000, 0) in link.sent
    assert link.sent[-1][1:] == (20, 0, 430, 100, 0)
    assert link.now == pytest.approx(T[-1] + program.AFTER, abs=0.05)  # trim, for who takes over
    assert np.diff([now for now, *_ in link.sent]).max() < 0.1  # never long enough to be lost
    assert link.texts == [
        "flown",
        "the sticks stay in trim for 10 s, then nothing is sent: take over",
    ]


def test_ctrl_c_leaves_the_sticks_in_trim_until_somebody_takes_over(program):
    link = Link(changes_at=5.0, interrupted_at=0.07)
    assert not fly(program, link)
    assert link.texts[0] == "broken off"
    assert link.sent[-1][1:] == (20, 0, 430, 100, 0)
    assert 4.9 < link.now < 5.1  # silent as soon as the mode changes


@pytest.mark.parametrize(
    ("trim", "words"),
    [
        ({"r": 101.0}, "axis r would go from 101 to 1001, which has -1000 to 1000: trim nearer"),
        ({"y": -900.0}, "axis y would go from -1100 to -800"),
        ({"z": -1.0}, "axis z would go from -1 to -1, which has 0 to 1000"),
    ],
)
def test_a_card_that_the_sticks_cannot_follow_from_trim_is_not_begun(program, trim, words):
    link = Link()
    with pytest.raises(SystemExit, match=words):
        fly(program, link, **trim)
    assert link.sent == []


def test_axis_z_has_half_the_units_of_the_others():
    px4_script(T, R, {"lat": ("y", 1000.0), "ped": ("z", 1000.0)}, "", CARD)  # by 500
    px4_script(T, R, {"lat": ("y", 1000.0), "ped": ("x", 2000.0)}, "", CARD)  # by 1000
    with pytest.raises(ValueError, match=r"'ped' on axis z moves by 501 units, .* 500 at most"):
        px4_script(T, R, {"lat": ("y", 1000.0), "ped": ("z", 1002.0)}, "", CARD)


def test_a_change_of_mode_breaks_the_card_off(program):
    link = Link(changes_at=0.05)
    assert not fly(program, link)
    assert link.now < 0.1


def test_the_card_is_read_back_from_its_file(program, tmp_path):
    (tmp_path / "card.csv").write_text(CARD)
    assert program.read(tmp_path / "card.csv") == {"t": [0.0, 0.04], "lat": [0.0, 0.1]}


def test_another_card_than_the_one_it_was_written_for_is_not_flown(program, tmp_path):
    (tmp_path / "card.csv").write_text(CARD.replace("0.1", "0.2"))
    with pytest.raises(SystemExit, match="not the card that this script was written for"):
        program.read(tmp_path / "card.csv")


def test_a_script_says_which_card_it_flies():
    known = hashlib.sha256(CARD.encode()).hexdigest()
    assert known in ardupilot_script(T, R, {"lat": (1, 500.0), "ped": (2, 500.0)}, "", CARD)


def test_a_script_of_casid_is_told_from_one_of_somebody_else(tmp_path):
    own, other = tmp_path / "card.lua", tmp_path / "inject.py"
    own.write_text(ardupilot_script(T, R, {"lat": (1, 500.0), "ped": (2, 500.0)}, "", CARD))
    other.write_text("print('mine')")
    assert [is_own(path) for path in (own, other, tmp_path / "none")] == [True, False, False]


@pytest.mark.parametrize(
    "make",
    [
        lambda: ardupilot_script(T, R, {"lat": (1, 20.0), "ped": (2, 500.0)}, "", CARD),
        lambda: px4_script(T, R, {"lat": ("y", 20.0), "ped": ("r", 1000.0)}, "", CARD),
    ],
    ids=["ardupilot", "px4"],
)
def test_a_card_that_rounding_eats_is_said(make):
    with pytest.warns(
        DataWarning, match=r"'lat' on .* moves by 4 .* raise it, .*\(SI, from -0.2 to 0.1; not"
    ):
        make()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ardupilot_script(T, R, {"lat": (1, 500.0)}, "", CARD), "'ped' is in one of card"),
        (
            lambda: ardupilot_script(T, R, {"lat": (1, 5e4), "ped": (2, 1.0)}, "", CARD),
            "by 10000 µs",
        ),
        (lambda: ardupilot_script(T, R, {"lat": (1, 99), "ped": (2, 1002)}, "", CARD), "by 501 µs"),
        (
            lambda: px4_script(T, R, {"lat": ("x", 99), "ped": ("r", 2002)}, "", CARD),
            "by 1001 units",
        ),
        (
            lambda: ardupilot_script(T, R, {"lat": (1, 5.0), "ped": (1, 5.0)}, "", CARD),
            "channel 1 is",
        ),
        (
            lambda: ardupilot_script(T, R, {"lat": (17, 5.0), "ped": (1, 5.0)}, "", CARD),
            "channel 17; ",
        ),
        (
            lambda: ardupilot_script(T, R, {"lat": (1.5, 5.0), "ped": (1, 5.0)}, "", CARD),
            "channel 1.5; ",
        ),
        (
            lambda: ardupilot_script(T, R, {"lat": (1, np.nan), "ped": (2, 5.0)}, "", CARD),
            "is nan; ",
        ),
        (
            lambda: ardupilot_script(T / 3, R, {"lat": (1, 5.0), "ped": (2, 5.0)}, "", CARD),
            "13.3333 ms",
        ),
        (
            lambda: px4_script(T, R, {"lat": ("x", 0.0), "ped": ("r", 1.0)}, "", CARD),
            "of 'lat' is 0.0",
        ),
        (
            lambda: px4_script(T, R, {"lat": ("q", 1.0), "ped": ("r", 1.0)}, "", CARD),
            "'lat' on axis 'q'",
        ),
    ],
)
def test_what_no_autopilot_could_fly_is_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_a_card_of_broken_milliseconds_is_refused():
    channels = {"lat": (1, 500.0), "ped": (2, 500.0)}
    for dt in (0.0202, 0.001):
        with pytest.raises(ValueError, match="whole milliseconds"):
            ardupilot_script(T / 0.04 * dt, R, channels, "", CARD)


def test_a_card_with_closer_samples_than_a_joystick_sends_is_said():
    with pytest.warns(DataWarning, match=r"10 ms apart, a joystick sends every 20 ms and skips"):
        px4_script(T / 4, R, {"lat": ("y", 1000.0), "ped": ("r", 1000.0)}, "", CARD)


def test_doubts_of_a_card_stand_in_the_heads_of_its_scripts_and_end_no_comment():
    doubts = ['the fit is not sound: """ quoted \\ and\nlet\nos.exit() in a comment; ' + 60 * "so "]
    lua = ardupilot_script(T, R, {"lat": (1, 500.0), "ped": (4, 400.0)}, "", CARD, doubts)
    lupa.lua54.LuaRuntime().execute(AUTOPILOT + lua)
    head = lua.splitlines()[1]
    assert head.startswith("-- DOUBTED: the fit is not sound: ''' quoted / and let os.exit()")
    python = px4_script(T, R, {"lat": ("y", 1000), "ped": ("r", 1800.0)}, "", CARD, doubts)
    assert "\nDOUBTED: the fit is not sound: '''" in ast.get_docstring(ast.parse(python))
    plain = px4_script(T, R, {"lat": ("y", 1000), "ped": ("r", 1800.0)}, "", CARD)
    assert "DOUBTED" not in plain
    assert "MANUAL_CONTROL: .\n\n    pip" in plain
