"""Systems with known answers, shared by the tests."""

import numpy as np

from casid import BlackBox, Record, StateSpace
from casid.linear import foh_step
from casid.subspace.campaign import Campaign, Windows
from casid.subspace.modal import to_modal
from casid.subspace.refinement_choice import refine_sampled

OMEGA = np.geomspace(0.3, 8.0, 25)


def unstable_plant():
    """Five states, two inputs, three outputs, an unstable pair 0.1 ± 0.5j and poles to -8."""
    A = np.array(
        [
            [0.1, 0.5, 0.0, 0.0, 0.0],
            [-0.5, 0.1, 1.0, 0.0, 0.0],
            [0.0, 0.0, -1.5, 2.5, 0.0],
            [0.0, 0.0, -2.5, -1.5, 1.0],
            [0.0, 0.0, 0.0, 0.0, -8.0],
        ]
    )
    B = np.array([[0.0, 0.5], [1.0, 0.0], [2.0, 0.5], [0.0, 1.5], [4.0, -2.0]])
    C = np.array([[1.0, 0, 0, 0.2, 0], [0, 1.0, 0.5, 0, 0], [0, 0, 1.0, 0, 0.5]])
    D = np.array([[0.0, 0.0], [0.0, 0.0], [0.3, 0.0]])
    return StateSpace(A, B, C, D, None, ("a", "b"), ("x", "y", "z"))


def stepped_input(N, nu, rng, hold=20):
    """Random two-level input, (N, nu)."""
    return np.repeat(rng.choice([-1.0, 1.0], size=(-(-N // hold), nu)), hold, axis=0)[:N]


def closed_loop_record(
    plant, rng, *, duration=20.0, dt=0.02, noise=0.0, gain=None, name="loop", lag=0.06, hold="foh"
):
    """A record of the plant under lagged output feedback, exact for first-order-hold inputs.

    The command u follows r - gain y through a first-order lag, so that it is known one sample ahead
    and the input between samples is the straight line the record says it is.
    """
    N = int(duration / dt) + 1
    gain = np.zeros((plant.nu, plant.ny)) if gain is None else gain
    reference = stepped_input(N, plant.nu, rng)
    Ad, B0, B1 = foh_step(plant.A, plant.B, dt)
    if hold == "zoh":
        B0, B1 = B0 + B1, np.zeros_like(B1)
    pole = np.exp(-dt / lag)
    x, u = np.zeros(plant.nx), np.zeros(plant.nu)
    us, ys = np.empty((N, plant.nu)), np.empty((N, plant.ny))
    for k in range(N):
        ys[k] = plant.C @ x + plant.D @ u + noise * rng.standard_normal(plant.ny)
        us[k] = u
        u_next = pole * u + (1 - pole) * (reference[k] - gain @ ys[k])
        x = Ad @ x + B0 @ u + B1 @ u_next
        u = u_next
    t = dt * np.arange(N)
    return Record(t, us, ys, plant.inputs, plant.outputs, name, hold)


STABILISING = np.array([[0.5, 1.2, 0.3], [1.0, 0.0, 0.0]])


def known_black_box(system, band=(0.1, 10.0)):
    """A black box that is the truth itself."""
    return BlackBox(
        system=system, K=np.zeros((system.nx, system.ny)), singular_values=np.ones(system.nx),
        pole=np.nan, past=1, future=1, transform="laguerre",
        feedthrough=np.ones((system.ny, system.nu), dtype=bool), input_std=np.ones(system.nu),
        output_std=response_size(system, band), band=band, records=(),
    )  # fmt: skip


def response_size(system, band):
    """Root mean square of each output's response over a band, for outputs of different units."""
    G = system.response(np.geomspace(*band, 20))
    return np.sqrt(np.mean(np.abs(G) ** 2, axis=(0, 2)))


def relative_error(system, truth, omega=OMEGA):
    G, G_hat = truth.response(omega), system.response(omega)
    return np.max(np.linalg.norm(G_hat - G, axis=(1, 2)) / np.linalg.norm(G, axis=(1, 2)))


def campaign(noise=0.0, seed=0, records=2, **options):
    rng = np.random.default_rng(seed)
    plant = unstable_plant()
    return [
        closed_loop_record(plant, rng, noise=noise, gain=STABILISING, name=f"r{i}", **options)
        for i in range(records)
    ]


def innovation_record(N=600, noise=0.1, seed=0):
    """An innovation model of three states with its gain, and a record of it."""
    rng, system = np.random.default_rng(seed), sampled_plant()
    A, B, C = system.A, system.B, system.C
    K = np.array([[0.3, 0.0], [0.1, 0.2], [0.0, 0.1]])
    e, u = noise * rng.standard_normal((N, 2)), stepped_input(N, 1, rng, hold=3)
    x, y = np.array([1.0, -1.0, 0.5]), np.empty((N, 2))
    for k in range(N):
        y[k] = C @ x + e[k]
        x = A @ x + B @ u[k] + K @ e[k]
    return system, K, Record(np.arange(N, dtype=float), u, y, ("u",), ("a", "b"), hold="zoh"), e


def predictor(system, K, su, sy):
    B = np.hstack([system.B, K])
    whole = StateSpace(system.A - K @ system.C, B, system.C, np.zeros((2, 3)))
    return to_modal(whole, np.concatenate([su, sy]), sy, np.zeros((2, 3), dtype=bool))


LAG = StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]], None, ("u",), ("y",))
ROTATION = [[-1.0, 2.0], [-2.0, -1.0]]
TWO = StateSpace(ROTATION, np.eye(2), np.eye(2), np.zeros((2, 2)), None, ("a", "b"), ("x", "y"))
DT = 0.05


def white(system, rng, *, duration=400.0, noise=0.0, mix=None, name="white"):
    """A record under white (linearly interpolated) inputs, correlated by ``mix``."""
    t = DT * np.arange(round(duration / DT) + 1)
    u = rng.standard_normal((len(t), system.nu))
    u = u if mix is None else u @ np.asarray(mix).T
    y = system.simulate(t, u) + noise * rng.standard_normal((len(t), system.ny))
    return Record(t, u, y, system.inputs, system.outputs, name)


def same(a, b):
    """Two records are equal to the last bit."""
    for attribute in ("t", "u", "y"):
        np.testing.assert_array_equal(getattr(a, attribute), getattr(b, attribute))
    names = ("inputs", "outputs", "hold", "trim")
    assert [getattr(a, name) for name in names] == [getattr(b, name) for name in names]


def sampled(record, order, how, feedthrough=False, past=None):
    """Subspace estimate of a record's samples, and what one refinement makes of it."""
    campaign = Campaign.of(record, feedthrough)
    past = past or max(10, -(-2 * order // record.ny))
    found = campaign.subspace(order, Windows(past, past, np.nan, 0.0))
    return refine_sampled(campaign, found, how)


def sampled_plant():
    """Three states every second, one input, two outputs."""
    A = np.array([[0.8, 0.3, 0], [-0.3, 0.8, 0.1], [0, 0, 0.5]])
    B, C = np.array([[1.0], [0.5], [1.0]]), np.array([[1.0, 0, 0.3], [0, 1.0, 0]])
    return StateSpace(A, B, C, np.zeros((2, 1)), 1.0)


def output_error_record(N=600, noise=0.3, seed=0):
    """The plant from a state that is not zero, white noise and a constant on its outputs."""
    rng, t = np.random.default_rng(seed), np.arange(N, dtype=float)
    u = stepped_input(N, 1, rng, hold=3)
    y = sampled_plant().simulate(t, u, x0=np.array([1.0, -1.0, 0.5])) + np.array([0.7, -0.4])
    y += noise * rng.standard_normal(y.shape)
    return Record(t, u, y, ("u",), ("a", "b"), hold="zoh")
