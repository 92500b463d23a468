"""Modes: names from textbook matrices, numbers from their poles, words."""

import numpy as np
import pytest

from casid import StateSpace, modes

# Bo105 at 80 kn: the eight-state matrix tabulated in G. D. Padfield, Helicopter Flight Dynamics,
# 2nd ed., appendix 4B.
STATES = ("u", "w", "q", "theta", "v", "p", "phi", "r")
BO105 = np.array(
    [
        [-0.0325, -0.0041, 1.5364, -9.8084, -0.0003, 0.0505, 0.0, 0.0],
        [-0.0394, -0.826, 41.0254, 0.2001, -0.0116, -0.3738, 0.2705, 0.0],
        [0.0309, 0.0195, -3.9954, 0.0, 0.0029, -0.2254, 0.0, 0.0],
        [0.0, 0.0, 0.9996, 0.0, 0.0, 0.0, 0.0, 0.0276],
        [0.0026, 0.007, 0.0519, -0.0054, -0.1259, -1.5838, 9.8046, -40.7909],
        [-0.0639, 0.1723, 1.1687, 0.0, -0.2812, -13.6124, 0.0, 0.3474],
        [0.0, 0.0, 0.0006, 0.0, 0.0, 1.0, 0.0, -0.0204],
        [-0.0347, -0.0153, 0.5476, 0.0, 0.1283, -2.1328, 0.0, -1.1568],
    ]
)


def free_system(A, states):
    n = len(states)
    return StateSpace(A, np.zeros((n, 1)), np.eye(n), np.zeros((n, 1)), None, (), (), states)


def test_modes_of_a_helicopter_get_their_textbook_names():
    found = [(mode.name, mode.pole) for mode in modes(free_system(BO105, STATES))]
    expected = [
        ("spiral", -0.024),
        ("phugoid", 0.016 + 0.305j),
        ("heave subsidence", -0.653),
        ("Dutch roll", -0.565 + 2.641j),
        ("pitch subsidence", -4.254),
        ("roll subsidence", -13.72),
    ]  # eigenvalues of the matrix, three digits
    assert [name for name, _ in found] == [name for name, _ in expected]
    np.testing.assert_allclose([p for _, p in found], [p for _, p in expected], atol=5e-3)


def test_airspeed_and_the_angles_of_the_flow_name_the_same_modes():
    # Along nearly level body axes at 80 kn, V is u, α is w/V and β is v/V.
    V = 80 * 0.514444
    size = np.array([1 / V if name in "wv" else 1.0 for name in STATES])
    names = [{"u": "V", "w": "alpha", "v": "beta"}.get(name, name) for name in STATES]
    of_flow = modes(free_system(BO105 * size[:, None] / size, names))
    assert [each.name for each in of_flow] == [
        each.name for each in modes(free_system(BO105, STATES))
    ]


def test_numbers_of_a_mode_are_those_of_its_pole():
    system = StateSpace([[0, 1], [-4.0, -0.4]], [[0], [1]], np.eye(2), np.zeros((2, 1)))
    (mode,) = modes(system)
    assert (mode.frequency, mode.damping) == (pytest.approx(2.0), pytest.approx(0.1))
    assert mode.time_constant == pytest.approx(5.0)
    assert mode.half == pytest.approx(5 * np.log(2))
    assert mode.name == "-"  # states x1, x2 say nothing of flight


@pytest.mark.parametrize("Mq", np.linspace(-1.3, -1.1, 7).tolist())
def test_without_a_speed_no_mode_is_a_phugoid(Mq):
    (mode,) = modes(free_system(np.array([[Mq, -4.0], [1.0, 0.0]]), ("q", "theta")))
    assert mode.name == "short period"


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_names_of_modes_do_not_depend_on_units(scale):
    T = np.diag([1, 1, scale, scale, 1, scale, scale, scale])
    scaled = free_system(T @ BO105 @ np.linalg.inv(T), STATES)
    names = [mode.name for mode in modes(free_system(BO105, STATES))]
    assert [mode.name for mode in modes(scaled)] == names


@pytest.mark.parametrize(
    ("A", "words"),
    [
        ([[0.0]], "integrator"),
        ([[-4.0]], "time constant 0.25 s"),
        ([[0.5]], "grows e-fold in 2 s"),
        ([[-0.3, 0.4], [-0.4, -0.3]], "0.5 rad/s, damping +0.60"),
        ([[0.3, 0.4], [-0.4, 0.3]], "0.5 rad/s, damping -0.60"),
    ],
)
def test_a_mode_is_told_in_the_words_of_flight_dynamics(A, words):
    n = len(A)
    (mode,) = modes(StateSpace(A, np.ones((n, 1)), np.ones((1, n)), [[0.0]]))
    assert mode.words == words
