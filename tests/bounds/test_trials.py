"""Single fits as jobs, and what a fit says about its likelihood."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from truths.closed_roll import TRUTH, flown
from truths.mixture import NOISE as SIGMA
from truths.mixture import Mixture, record

from casid import (
    ConvergenceError,
    Execution,
    Model,
    OutputError,
    Record,
    Scalar,
    SolverOptions,
    parameter,
)
from casid.bounds.trials import Fits, aicc, spelt_out, work
from casid.errors import asked, unasked
from casid.jobs.transport import refer

NOISE = {"ay": 0.05, "p": 0.005, "phi": 0.005}


def as_white(fit):
    """The fit as if its residuals were white: every free direction counts one."""
    return replace(fit, covariance=fit.notes.cramer_rao)


def expected(fit, k, n):
    """N. Sugiura's corrected criterion with k numbers from n measurements."""
    return 2 * fit.cost + 2 * k * n / (n - k - 1)


@pytest.mark.parametrize(
    ("settings", "beside"),
    [
        ({}, 2 * 2 + 2 * 1 + 1),  # initial states, biases, one variance
        ({"biases": False}, 2 * 2 + 1),
        ({"R": np.array([[SIGMA**2]])}, 2 * 2 + 2 * 1),
        ({"R": np.array([[SIGMA**2]]), "biases": False}, 2 * 2),
    ],
)
def test_aicc_counts_what_was_estimated_and_no_more(settings, beside):
    records = [record(0), record(1)]
    fit = OutputError(**settings).fit(Mixture(), records)
    n = sum(each.N for each in records)
    assert aicc(as_white(fit), records) == pytest.approx(expected(fit, 3 + beside, n), rel=1e-12)


class Integral(Model):
    """Roll and its integral."""

    states, inputs, outputs = ("p", "phi"), ("lat",), ("p", "phi")

    Lp: Scalar = parameter(default=-2.0, lower=-10.0, upper=0.0, unit="1/s")
    Lphi: Scalar = parameter(default=0.0, lower=-2.0, upper=2.0, unit="1/s^2")

    def A(self):
        return [[self.Lp, self.Lphi], [1, 0]]

    def B(self):
        return [[8.0], [0]]


@pytest.mark.parametrize("biases", [True, ("p",), ("phi",), False], ids=str)
@pytest.mark.parametrize("Lphi", [0.0, -0.3])
def test_aicc_counts_initial_states_and_biases_that_outputs_tell_apart(biases, Lphi):
    rng, t = np.random.default_rng(1), 0.05 * np.arange(200)
    u = np.sign(np.sin(t))[:, None]
    truth = Integral(Lphi=Lphi).system()
    records = [
        Record(t, u, truth.simulate(t, u, hold="zoh") + 0.02 * rng.standard_normal((200, 2)),
               ("lat",), ("p", "phi"), f"r{k}", "zoh") for k in range(2)
    ]  # fmt: skip
    fit = OutputError(biases=biases, R=np.eye(2) * 0.02**2).fit(
        Integral(Lphi=Lphi), records, fixed=("Lphi",)
    )
    names = {True: ("p", "phi"), False: ()}.get(biases, biases)
    free = np.array([truth.C @ scipy.linalg.expm(truth.A * each) for each in t])
    chosen = np.eye(2)[:, [name in names for name in ("p", "phi")]]
    both = np.concatenate([free, np.broadcast_to(chosen, (200, 2, len(names)))], axis=2)
    told = np.linalg.matrix_rank(both.reshape(400, -1), rtol=1e-8)
    k = 1 + 2 * told
    assert aicc(as_white(fit), records) == pytest.approx(expected(fit, k, 800), rel=1e-12)


def flight():
    return flown().between(0.0, 6.0).with_noise(NOISE, np.random.default_rng(1))


@pytest.mark.parametrize(("R", "variances"), [("diagonal", 3), ("full", 6)])
def test_aicc_counts_covariances(R, variances):
    fit = OutputError(R=R).fit(TRUTH, flight(), fixed=("tau",))
    k = len(fit.free_names) - fit.held + 3 + 3 + variances
    assert aicc(as_white(fit), [flight()]) == pytest.approx(
        expected(fit, k, flight().y.size), rel=1e-12
    )


@pytest.mark.second
def test_aicc_counts_a_free_gain():
    R, few = np.diag(list(NOISE.values())) ** 2, SolverOptions(max_iterations=1)
    with pytest.raises(ConvergenceError) as stopped:  # what is counted does not depend on success
        OutputError(R=R, process_noise="gain", solver=few).fit(TRUTH, flight())
    fit = stopped.value.best
    k = len(fit.free_names) - fit.held + 3 + 3 + 3 * 3
    assert aicc(as_white(fit), [flight()]) == pytest.approx(
        expected(fit, k, flight().y.size), rel=1e-12
    )


def test_aicc_counts_a_parameter_by_the_variance_its_estimate_has():
    # Takeuchi's trace of P⁻¹ V: the fit's own over all its free directions, here 4, 1 and 9.
    fit, r = OutputError().fit(Mixture(), record()), record()
    unit = np.linalg.cholesky(fit.notes.cramer_rao)
    wide = replace(fit, covariance=unit @ np.diag([4.0, 1.0, 9.0]) @ unit.T)
    assert aicc(wide, [r]) == pytest.approx(expected(fit, 14 + 2 + 1 + 1, r.N), rel=1e-9)


def test_a_case_with_a_tie_is_told_with_the_users_class_and_in_its_units():
    many = Fits(Mixture(), [record()], OutputError(), (), None, Execution())
    job = many.job(*many.cases({"tied": ["40 a + 40 b <= 20"]}))
    fit = work(job.payload, None)
    assert type(fit.model) is Mixture
    (row,) = fit.constraints
    assert fit.model.a + fit.model.b == pytest.approx(0.5, abs=1e-6)
    assert (row.value, row.upper) == pytest.approx((20.0, 20.0), abs=1e-4)


def test_names_of_estimators_are_words():
    assert spelt_out("OutputError") == "output error"
    assert spelt_out("Match") == "match"


def test_a_trial_of_other_data_options_or_code_has_another_key(monkeypatch):
    def key(data=(0,), model=None, **settings):
        model = model or Mixture()
        records = [record(s) for s in data]
        many = Fits(model, records, OutputError(**settings), (), None, Execution())
        return many.job(*many.cases({"free": {}})).key

    keys = [key(), key((1,)), key(model=Mixture(a=0.7)), key(interval=1.0), key(R=np.eye(1))]
    assert key() == keys[0]
    others = {"source_digest": lambda: "", "equations_digest": lambda _: "",
              "refer": lambda cls: replace(refer(cls), digest="")}  # fmt: skip
    for name, other in others.items():
        with monkeypatch.context() as patch:
            patch.setattr(f"casid.bounds.trials.{name}", other)
            keys.append(key())
    assert len(set(keys)) == len(keys)


class ListeningOutputError(OutputError):
    """Says whether it was to ask its data."""

    def fit(self, *given, near=None, **settings):
        heard.append(asked())
        with unasked():
            return super().fit(*given, near=near, **settings)


heard = []


@pytest.mark.second
def test_what_nobody_is_to_ask_is_asked_unless_a_fit_nearby_has_succeeded():
    data = [record()]
    with unasked():
        good = OutputError().fit(Mixture(), data)
    many = Fits(Mixture(), data, ListeningOutputError(), (), None, Execution())
    (case,) = many.cases({"free": {}})
    starts = {"model": Mixture(), "good": good, "poor": replace(good, success=False)}
    jobs = {
        name: [many.job(case, start, asked=own) for own in (True, False)]
        for name, start in starts.items()
    }
    assert len({job.key for each in jobs.values() for job in each}) == 6
    for name, both in jobs.items():
        heard.clear()
        for job in both:
            work(job.payload, None)
        assert heard == [True, name != "good"]
