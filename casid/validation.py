"""How well models predict records they have not seen: λ stays, initial state and biases follow.

Measures as in M. Bergamasco, M. Lovera, "Rotorcraft system identification: a time/frequency domain
approach", Fig. 11 (RMS divided by the largest among the models), and R. Jategaonkar, Flight Vehicle
System Identification, chapter 11 (Theil's coefficient, whiteness of the residuals).

The simulated output is linear in what is not known of a record,

    y(t) = y_forced(t) + Φ(t) z + b,

so initial state and biases are one linear least-squares problem, outputs weighted by the inverse of
their standard deviations. Growing modes would swamp the columns of Φ = C exp(A t) in a long
record, therefore the state is split (real Schur form, Sylvester equation) into a part that is
simulated forward from its value at the start and a fast growing part that is simulated backward
from its value at the end. Every column then is bounded, and nothing is lost however unstable the
model.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from casid.arrays import Array
from casid.fit import AnyFit, Fit
from casid.linear import StateSpace
from casid.model import Model
from casid.record import Hold, Record, Records, same_channels, standard_deviations, stretches
from casid.subspace.pbsid import BlackBox

RANK = 1e-10  # singular values below this share of the largest are directions without effect
LAGS = 40  # largest lag of the whiteness test
BAND = 2.5758293035489004  # 99 % band of a white sequence's autocorrelations, in 1/√N

AnyModel = Model | AnyFit | BlackBox | StateSpace


@dataclass(frozen=True, eq=False, kw_only=True)
class Validation:
    """Measures of every model on every record; each mapping goes from a model's name to an array.

    Parameters
    ----------
    models, records, outputs, inputs : tuple of str
        Names; of the channels, those of the records.
    rms : mapping to (records, ny) array
        Root mean square of the residual, in the unit of the output.
    normalised : mapping to (records, ny) array
        The same divided by the largest among the models: the worst has 1.
    fit : mapping to (records, ny) array
        100 (1 - ‖y - ŷ‖ / ‖y - mean y‖) [%].
    theil : mapping to (records, ny) array
        Theil's inequality coefficient rms(y - ŷ) / (rms y + rms ŷ): 0 is perfect, 1 useless.
    whiteness : mapping to (records, ny) array
        Share of the residual's autocorrelations at lags of 1 to 40 samples inside the 99 % band of
        a white sequence: about 0.99 when white, near 0 when the model has missed dynamics. Missing
        samples are passed over.
    measured : tuple of Record
        The records.
    simulated : mapping to tuple of (N, ny) array
        Outputs of each model on each record, biases included.
    initial_states : mapping to tuple of (nx,) array
        Estimated state at the first sample; meaningless where a mode leaves no trace in the record.
    biases : mapping to (records, ny) array
        Estimated constant of each output.

    A model that lacks an output of the records has NaN there.
    """

    models: tuple[str, ...]
    records: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    rms: Mapping[str, Array]
    normalised: Mapping[str, Array]
    fit: Mapping[str, Array]
    theil: Mapping[str, Array]
    whiteness: Mapping[str, Array]
    measured: tuple[Record, ...]
    simulated: Mapping[str, tuple[Array, ...]]
    initial_states: Mapping[str, tuple[Array, ...]]
    biases: Mapping[str, Array]


def validate(models: Mapping[str, AnyModel], records: Records) -> Validation:
    """Simulate each model on each record and measure what is left.

    Parameters
    ----------
    models : mapping
        A name for each `Model`, `Fit`, `BlackBox` or `StateSpace`, continuous or discrete. A model
        takes its inputs from the records by name, and is judged on the outputs it has.
    records : Record or sequence of Record
        Best ones not used in the estimation. All with the same channels.

    Returns
    -------
    Validation

    Raises
    ------
    ValueError
        No model, no record, a model whose inputs the records lack, no output in common, a discrete
        model whose interval is not that of the records, a model with NaN in it.
    """
    if not models:
        raise ValueError('no models given; expected {"name": model, ...}')
    records = stretches(records)
    inputs, outputs = same_channels(records)
    scale = standard_deviations(records)[1]
    predictions = {
        name: [_predict(name, state_space(model), record, scale) for record in records]
        for name, model in models.items()
    }
    simulated = {name: tuple(p.y for p in ps) for name, ps in predictions.items()}
    rms = {name: _each(rms_error, records, ys) for name, ys in simulated.items()}
    worst = np.fmax.reduce([np.zeros((len(records), len(outputs))), *rms.values()])
    worst[worst == 0] = 1.0
    return Validation(
        models=tuple(models),
        records=tuple(record.name for record in records),
        inputs=inputs,
        outputs=outputs,
        rms=rms,
        normalised={name: values / worst for name, values in rms.items()},
        fit={name: _each(fit_percent, records, ys) for name, ys in simulated.items()},
        theil={name: _each(theil_coefficient, records, ys) for name, ys in simulated.items()},
        whiteness={name: _each(_whiteness, records, ys) for name, ys in simulated.items()},
        measured=records,
        simulated=simulated,
        initial_states={name: tuple(p.x0 for p in ps) for name, ps in predictions.items()},
        biases={name: np.array([p.b for p in ps]) for name, ps in predictions.items()},
    )


def state_space(model: AnyModel) -> StateSpace:
    """The linear system behind a structure, a fit or a black box."""
    if isinstance(model, StateSpace):
        return model
    if isinstance(model, Fit):
        return model.model.system()
    return model.system() if isinstance(model, Model) else model.system


# ---- prediction ----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Prediction:
    y: Array  # (N, ny of the record), NaN where the model has no such output
    x0: Array
    b: Array


def _predict(name: str, system: StateSpace, record: Record, scale: Array) -> _Prediction:
    """Simulation with the initial state and biases that suit the record best."""
    for letter in "ABCD":
        if not np.isfinite(getattr(system, letter)).all():
            raise ValueError(f"model {name!r}: {letter} is not finite; it cannot be simulated")
    if missing := [channel for channel in system.inputs if channel not in record.inputs]:
        raise ValueError(
            f"model {name!r} has input {missing[0]!r}, record {record.name!r} has inputs "
            f"{', '.join(record.inputs)}"
        )
    shared = [i for i, output in enumerate(record.outputs) if output in system.outputs]
    if not shared:
        raise ValueError(
            f"model {name!r} has outputs {', '.join(system.outputs)}, record {record.name!r} has "
            f"{', '.join(record.outputs)}: none in common"
        )
    rows = [system.outputs.index(record.outputs[i]) for i in shared]
    u = record.u[:, [record.inputs.index(channel) for channel in system.inputs]]
    try:
        states, direct = _states(system, record.t, u, record.hold)
    except ValueError as error:
        raise ValueError(f"model {name!r}, record {record.name!r}: {error}") from error
    response = system.C[rows] @ states  # (N, outputs shared, 1 + nx)
    forced, free = response[:, :, 0] + direct[:, rows], response[:, :, 1:]
    z, b = _fit_unknowns(record.y[:, shared] - forced, free, scale[shared])
    y, biases = np.full(record.y.shape, np.nan), np.full(record.ny, np.nan)
    y[:, shared], biases[shared] = forced + free @ z + b, b
    return _Prediction(y, states[0, :, 0] + states[0, :, 1:] @ z, biases)


def _states(system: StateSpace, t: Array, u: Array, hold: Hold) -> tuple[Array, Array]:
    """Forced and free responses of the state, all bounded, and the direct term of the outputs.

    Returns
    -------
    states : (N, nx, 1 + nx) array
        Column 0: the response to u with slow modes at zero at the start and fast growing ones at
        zero at the end; the others: free responses to a unit of either.
    direct : (N, ny) array
        D u(t - τ).
    """
    steps = system.steps(t, u, hold)
    V, ns = _split(system, float(t[-1] - t[0]))
    maps = [np.linalg.solve(V, Ad @ V) for Ad in steps.maps]
    forcing = np.linalg.solve(V, steps.forcing.T).T
    n, nx = len(steps.which), system.nx
    z = np.zeros((n + 1, nx, 1 + nx))
    z[0, :ns, 1 : 1 + ns] = np.eye(ns)
    z[n, ns:, 1 + ns :] = np.eye(nx - ns)
    forward = [Ad[:ns, :ns] for Ad in maps]
    backward = [np.linalg.inv(Ad[ns:, ns:]) for Ad in maps]
    for k in range(n):
        z[k + 1, :ns] = forward[steps.which[k]] @ z[k, :ns]
        z[k + 1, :ns, 0] += forcing[k, :ns]
    for k in range(n - 1, -1, -1):
        ahead = z[k + 1, ns:].copy()
        ahead[:, 0] -= forcing[k, ns:]
        z[k, ns:] = backward[steps.which[k]] @ ahead
    return V @ z, steps.direct


def _split(system: StateSpace, span: float) -> tuple[Array, int]:
    """Coordinates V and a number ns: V⁻¹ A V is block diagonal, slow modes first.

    Fast is what grows more than about e² over the record; the border lies in the widest gap between
    the growth rates near there, so that the Sylvester equation is well conditioned.
    """
    poles = np.linalg.eigvals(system.A)
    if system.dt is None:
        rates, border = poles.real, np.array([0.5, 5.0]) / span
    else:
        rates, border = np.abs(poles), np.exp(np.array([0.5, 5.0]) * system.dt / span)
    near = np.sort(rates[(rates > border[0]) & (rates < border[1])])
    edges = np.concatenate([border[:1], near, border[1:]])
    widest = int(np.argmax(np.diff(edges)))
    limit = edges[widest : widest + 2].mean()

    def slow(real: float, imag: float) -> bool:
        return bool((real if system.dt is None else np.hypot(real, imag)) < limit)

    S, Z, ns = scipy.linalg.schur(system.A, output="real", sort=slow)
    X = scipy.linalg.solve_sylvester(S[:ns, :ns], -S[ns:, ns:], -S[:ns, ns:])
    V = Z.copy()
    V[:, ns:] += Z[:, :ns] @ X
    return V, ns


def _fit_unknowns(residual: Array, free: Array, scale: Array) -> tuple[Array, Array]:
    """Least squares for free responses z (nx,) and biases b (ny,); missing samples are left out.

    Columns are scaled to one; directions without effect on the outputs get zero.
    """
    N, ny, nx = free.shape
    biases = np.broadcast_to(np.eye(ny), (N, ny, ny))
    columns = (np.concatenate([free, biases], axis=2) / scale[:, None]).reshape(N * ny, nx + ny)
    target = (residual / scale).ravel()
    there = ~np.isnan(target)
    columns, target = columns[there], target[there]
    size = np.linalg.norm(columns, axis=0)
    size[size == 0] = 1.0
    solution = np.linalg.lstsq(columns / size, target, rcond=RANK)[0] / size
    return solution[:nx], solution[nx:]


# ---- measures ------------------------------------------------------------------------------------


def _each(
    measure: Callable[[Array, Array], float], records: Sequence[Record], simulated: Sequence[Array]
) -> Array:
    """A measure of every record and output, (records, ny); missing samples left out."""
    table = np.full((len(records), records[0].ny), np.nan)
    for i, (record, y_model) in enumerate(zip(records, simulated, strict=True)):
        for j in range(record.ny):
            there = ~np.isnan(record.y[:, j]) & ~np.isnan(y_model[:, j])
            if there.any():
                table[i, j] = measure(record.y[there, j], y_model[there, j])
    return table


def rms_error(y: Array, y_model: Array) -> float:
    """Root of the mean squared error."""
    return float(np.sqrt(np.mean((y - y_model) ** 2)))


def fit_percent(y: Array, y_model: Array) -> float:
    """100 (1 - ‖y - ŷ‖/‖y - mean y‖); NaN for an output that does not move."""
    spread = float(np.linalg.norm(y - y.mean()))
    return 100 * (1 - float(np.linalg.norm(y - y_model)) / spread) if spread > 0 else np.nan


def theil_coefficient(y: Array, y_model: Array) -> float:
    """RMS error over the sum of both RMS values; NaN for an output that is zero."""
    size = float(np.sqrt(np.mean(y**2)) + np.sqrt(np.mean(y_model**2)))
    return rms_error(y, y_model) / size if size > 0 else np.nan


def _whiteness(y: Array, y_model: Array) -> float:
    e = y - y_model
    e = e - e.mean()
    N, power = len(e), float(e @ e)
    lags = min(LAGS, N // 4)
    if lags < 1 or power <= 0:
        return np.nan
    correlation = np.array([e[lag:] @ e[:-lag] for lag in range(1, lags + 1)]) / power
    return float(np.mean(np.abs(correlation) <= BAND / np.sqrt(N)))
