"""Measured responses beside time histories: is the joint estimate what its information says?

    OMP_NUM_THREADS=1 python -m benchmarks.responses [--runs 50] [--first 0] [--only WORDS]
        [--domain time]

A short period of two states is known. Two 3-2-1-1 of 12 s enter as time histories; beside them
stands a response: "a table" of 25 frequencies with errors of 4 % of the truth, as another tool
would hand over; "the same, correlated" in frequency and between the outputs; "another flight", two
sweeps of 80 s with noise by `frequency_response`; "a slow mode", the same of an aircraft whose mode
of 0.4 rad/s hardly decays within a local model, from 0.15 rad/s on, with a third of that noise.
Root mean square over runs and parameters of the errors over the Cramér-Rao bounds of the joint fit:
of it, of those by the records alone and by the response alone (quadratic match); of the joint one
the least and largest parameter too, and how many errors lie within its stated 95 % intervals.
"""

import argparse
import time
import warnings

import numpy as np

from benchmarks.tables import table
from casid import (
    FrequencyResponse,
    Model,
    Record,
    Rows,
    Scalar,
    frequency_response,
    match,
    output_error,
    parameter,
)

OMEGA = np.geomspace(0.5, 10.0, 25)
SHARE = 0.04  # error of a table's points
NOISE = {"az": 0.3, "q": 0.006}
STEP = 0.04


class ShortPeriod(Model):
    """Heave and pitch of a helicopter at speed."""

    states = ("w", "q")
    inputs = ("lon",)
    outputs = ("az", "q")

    Zw: Scalar = parameter(default=-0.8, lower=-4.0, upper=0.0, unit="1/s")
    Mw: Scalar = parameter(default=-0.03, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Mq: Scalar = parameter(default=-1.6, lower=-10.0, upper=0.0, unit="1/s")
    Zlon: Scalar = parameter(default=-12.0, lower=-60.0, upper=60.0, unit="m/s^2")
    Mlon: Scalar = parameter(default=6.0, lower=0.0, upper=40.0, unit="rad/s^2")
    tau: Scalar = parameter(default=0.07, lower=0.0, upper=0.25, unit="s")

    def A(self) -> Rows:
        return [[self.Zw, 40.0], [self.Mw, self.Mq]]

    def B(self) -> Rows:
        return [[self.Zlon], [self.Mlon]]

    def C(self) -> Rows:
        return [[self.Zw, 0], [0, 1]]

    def D(self) -> Rows:
        return [[self.Zlon], [0]]

    def delays(self) -> dict[str, Scalar]:
        return {"lon": self.tau}


TRUTH = ShortPeriod()
SLOW = ShortPeriod(Zw=-0.1, Mw=-0.0035, Mq=-0.15)
NAMES = TRUTH.parameter_names()


def steps(truth, rng):
    """Two noisy 3-2-1-1 of either sign."""
    t = STEP * np.arange(300)
    edges = ((1, 1, 4), (-1, 4, 6), (1, 6, 7), (-1, 7, 8))
    u = 0.04 * sum(s * ((t > a) & (t <= b)) for s, a, b in edges)
    return [flown(truth, t, sign * u, rng, f"3211 {sign}") for sign in (1, -1)]


def sweeps(truth, rng, low=0.3, times=3.0):
    """Two noisy sweeps from a frequency [rad/s], with so many times the usual noise."""
    t = STEP * np.arange(2000)
    since, rate = np.clip(t - 2, 0, 74), np.log(14 / low)
    fade = np.clip(np.minimum(since / 4, (78 - t) / 2), 0, 1)
    u = 0.04 * fade * np.sin(low * 74 / rate * (np.exp(rate * since / 74) - 1))
    return [flown(truth, t, sign * u, rng, f"sweep {sign}", times) for sign in (1, -1)]


def flown(truth, t, u, rng, name, times=1.0):
    """A record of a truth with noise, so many times the usual."""
    y = truth.system().simulate(t, u[:, None])
    record = Record(t, u[:, None], y, TRUTH.inputs, TRUTH.outputs, name)
    return record.with_noise({each: times * std for each, std in NOISE.items()}, rng)


def tabulated(rng, width, along):
    """The truth's response with errors correlated over a width [rad/s] and between outputs."""
    G, (K, ny) = TRUTH.system().response(OMEGA), (len(OMEGA), 2)
    across = np.tile(np.array([[1, along], [np.conj(along), 1]]), (K, 1, 1))
    apart = OMEGA[:, None] - OMEGA
    rho = np.eye(K) if width == 0 else np.exp(-(apart**2) / (4 * width**2))
    values, vectors = np.linalg.eigh(rho)
    root = vectors * np.sqrt(np.maximum(values, 0))
    white = rng.standard_normal((K, ny)) + 1j * rng.standard_normal((K, ny))
    error = SHARE * np.abs(G) * ((root @ white) @ np.linalg.cholesky(across[0]).T)[:, :, None]
    ones = np.ones(G.shape)
    return FrequencyResponse(
        omega=OMEGA, G=G + error, coherence=ones, random_error=SHARE * ones,
        inputs=TRUTH.inputs, outputs=TRUTH.outputs, input_std=np.ones(1), output_std=np.ones(2),
        resolution=width * ones, output_correlation=across,
    )  # fmt: skip


def slow_sweeps(rng):
    """The response of two sweeps from below the slow mode."""
    return frequency_response(sweeps(SLOW, rng, 0.2, 1.0), omega=np.geomspace(0.15, 10.0, 30))


RESPONSES = {
    "a table": (TRUTH, lambda rng: tabulated(rng, 0.0, 0.0)),
    "the same, correlated": (TRUTH, lambda rng: tabulated(rng, 0.4, 0.8j)),
    "another flight": (TRUTH, lambda rng: frequency_response(sweeps(TRUTH, rng), omega=OMEGA)),
    "a slow mode": (SLOW, slow_sweeps),
}


def measure(kind, runs, first, domain):
    """Errors over the joint fit's bounds (runs, nf) by source, its processor time, share held."""
    truth, measured = RESPONSES[kind]
    ratios, taken, held = {"joint": [], "records": [], "response": []}, 0.0, []
    for run in range(first, first + runs):
        rng = np.random.default_rng([run, 11])
        records, response = steps(truth, rng), measured(rng)
        begin = time.process_time()
        joint = output_error(truth, records, responses=response, domain=domain)
        taken += time.process_time() - begin
        alone = output_error(truth, records, domain=domain)
        other = match(truth, response, norm="quadratic", weight="relative")
        bound = np.array([joint[name].cramer_rao for name in NAMES])
        off = joint.model.vector() - truth.vector()
        held.append(np.abs(off) < 1.96 * np.array([joint[name].std_error for name in NAMES]))
        for name, fit in (("joint", joint), ("records", alone), ("response", other)):
            ratios[name].append((fit.model.vector() - truth.vector()) / bound)
    return {name: np.array(each) for name, each in ratios.items()}, taken / runs, np.mean(held)


def main():
    warnings.simplefilter("ignore")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", default="", help="words that a response must have")
    parser.add_argument("--domain", choices=("time", "frequency"), default="time")
    chosen = parser.parse_args()
    rows = []
    for kind in (each for each in RESPONSES if chosen.only in each):
        ratios, taken, held = measure(kind, chosen.runs, chosen.first, chosen.domain)
        size = {name: np.sqrt(np.mean(each**2)) for name, each in ratios.items()}
        least, most = (f(np.sqrt(np.mean(ratios["joint"] ** 2, axis=0))) for f in (min, max))
        rows.append([kind, *size.values(), least, most, 100 * held, taken])
    print(table(["response", "joint", "records alone", "response alone", "least", "largest",
                 "covered %", "processor [s]"], rows))  # fmt: skip


if __name__ == "__main__":
    main()
