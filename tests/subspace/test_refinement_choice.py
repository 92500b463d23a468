"""What follows the subspace estimate."""

import numpy as np
import pytest
import scipy.signal
from truths.systems import campaign, innovation_record, relative_error, unstable_plant

from casid import DataWarning, Record, pbsid
from casid.subspace import refinement_choice
from casid.subspace.campaign import Campaign, Windows
from casid.subspace.refinement_choice import Estimate, refine_projected, refine_sampled


@pytest.mark.parametrize("how", ["unrefined", "linear", "prediction", "simulation"])
def test_each_criterion_is_least_for_its_own_estimate(how):
    # Prediction and simulation errors of the four, on the samples they come from.
    _, _, record, _ = innovation_record(N=400)
    made = Campaign.of(record, False)
    found = made.subspace(3, Windows(10, 10, np.nan, 0.0))
    estimate = refine_sampled(made, found, how)
    if how == "unrefined":
        assert estimate.system is found.system
        assert estimate.K is found.K
    if how == "linear":  # the predictor's dynamics and C stay
        kept, moved = (each.system.A - each.K @ each.system.C for each in (found, estimate))
        np.testing.assert_allclose(moved, kept, atol=1e-9)
        np.testing.assert_allclose(estimate.system.C, found.system.C)
    assert (estimate.uncertainty is not None) is (how == "prediction")
    assert estimate.K.any() == (how != "simulation")

    def errors(system, K):
        x, e = np.zeros(3), np.empty_like(record.y)
        for k in range(record.N):
            e[k] = record.y[k] - system.C @ x - system.D @ record.u[k]
            x = system.A @ x + system.B @ record.u[k] + K @ e[k]
        return np.linalg.slogdet(np.cov(e[20:].T))[1]

    if how == "prediction":
        assert errors(estimate.system, estimate.K) <= errors(found.system, found.K) + 1e-3
    if how == "simulation":
        none = np.zeros_like(found.K)
        assert errors(estimate.system, none) < errors(found.system, none)


def test_projections_move_only_if_asked_and_then_to_the_truth():
    flights = campaign(noise=0.02)
    made = Campaign.of(flights, ["z"])
    windows = Windows(10, 10, 6.0, 0.0)
    found = made.subspace(5, windows)
    still = refine_projected(made, found, 6.0, move=False)
    assert still.system is found.system
    assert still.uncertainty is None
    moved = refine_projected(made, found, 6.0, move=True, windows=windows)
    assert moved.uncertainty is not None
    assert moved.missed is None  # two states more explain nothing
    assert not len(moved.doubtful)  # the plant is unstable
    assert (moved.explained > 0.9).all()
    truth = unstable_plant()
    assert relative_error(moved.system, truth) < relative_error(found.system, truth)
    # The gain is the subspace estimate's in the modes of the moved model: so is the predictor.
    before, after = (
        np.sort_complex(np.linalg.eigvals(each.system.A - each.K @ each.system.C))
        for each in (found, moved)
    )
    np.testing.assert_allclose(after, before, rtol=0.1)


@pytest.mark.parametrize(
    ("share", "size", "chance", "distance", "ratio", "chosen"),
    [
        (0.02, 1.0, 0.01, 9.0, 1.0, "transforms"),  # little is fed back
        (0.04, 0.9, 0.05, 9.0, 1.0, "transforms"),  # or no more than chance makes
        (0.04, 0.9, 0.01, 0.39, 1.0, "transforms"),  # which does not matter
        (0.04, 0.9, 0.01, 0.41, 0.86, "prediction errors"),  # or does
        (0.04, 0.9, 0.01, 0.41, 0.84, "transforms, with a remark"),  # errors too small to be true
        (0.04, 1.1, 0.01, 0.39, 0.84, "prediction errors"),  # √0.04 of 1.1 is more than a fifth
    ],
)
def test_noise_fed_back_is_answered_by_prediction_errors(
    share, size, chance, distance, ratio, chosen, monkeypatch
):
    flown = Campaign.of(campaign(records=1, duration=12.0), True)
    plant, K = unstable_plant(), np.zeros((5, 3))
    for name, answer in (
        ("fed_back", (share, size, chance)), ("refine_held", (plant, K + 1, None, plant)),
        ("riccati_gain", K + 2), ("missed_direct", None), ("_apart", (distance, ratio)),
    ):  # fmt: skip
        monkeypatch.setattr(refinement_choice, name, lambda *_, answer=answer: answer)
    found = Estimate(plant, K)
    if chosen.endswith("remark"):
        told = (
            f"prediction errors, which is not biased so, is {distance} stated errors away, but "
            "its own stated errors are too small for records as short as these; longer records"
        )
        with pytest.warns(DataWarning, match=told):
            other = refinement_choice._without_feedback(found, flown, 6.0, np.eye(3))
        assert other.system is plant
        assert told in other.remark
    else:
        other = refinement_choice._without_feedback(found, flown, 6.0, np.eye(3))
        assert other.remark == ""
    np.testing.assert_array_equal(other.K, K + 2 * (chosen == "prediction errors"))


A, B = np.array([[-2.2, -0.9], [3.0, -1.1]]), np.array([[7.0, 0.8], [-2.0, -9.0]])
C, D = np.vstack([[1.0, 0.0], A[1]]), np.vstack([[0.0, 0.0], B[1]])
LATE = 0.1  # s, of the first input


def swept(seed):
    """Rate and acceleration of a short period, a sweep of each input in a record of its own."""
    t, rng, records = 0.02 * np.arange(3000), np.random.default_rng(seed), []
    sweep = 0.1 * scipy.signal.chirp(t, 0.5 / 2 / np.pi, t[-1], 14 / 2 / np.pi, "log", phi=-90)
    for axis in range(2):
        lag, other = [1, -np.exp(-0.1)], rng.standard_normal(len(t))
        for _ in range(2):
            other = scipy.signal.lfilter([1], lag, other)
        u = np.column_stack([sweep, 0.01 * other / other.std()])[:, [axis, 1 - axis]]
        late = np.column_stack([np.interp(t - LATE, t, u[:, 0], left=0.0), u[:, 1]])
        y = scipy.signal.lsim((A, B, C, D), late, t)[1]
        y += [0.01, 0.15] * rng.standard_normal(y.shape)
        records.append(Record(t, u, y, ("lon", "col"), ("q", "az"), f"sweep_{axis}"))
    return records


@pytest.mark.campaign
def test_a_chosen_order_follows_a_delay_that_roughly_refined_models_miss():
    # Of models of two states more that are refined in one round, some leave more than fewer states.
    omega = np.geomspace(6.0, 12.0, 8)
    s, off = 1j * omega, []
    truth = C[0] @ np.linalg.inv(s[:, None, None] * np.eye(2) - A) @ B[:, 0] * np.exp(-LATE * s)
    for seed in range(16):
        box = pbsid(swept(seed), feedthrough=["az"])
        turned = np.angle(box.response(omega)[:, 0, 0] / truth)
        off.append(turned / box.response_std(omega)[1][:, 0, 0])
    assert np.sqrt(np.mean(np.square(off))) < 1.2
