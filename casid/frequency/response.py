"""Measured frequency responses with their quality."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casid.arrays import Array, BoolArray, ComplexArray
from casid.display import Shown, listed
from casid.records import several
from casid.textfile import read_json, write_result
from casid.values import DAMAGED, check_digest, decode, storable

PrintedFlight = tuple[str, tuple[str, ...], tuple[str, ...], tuple[str, ...]]

PAIRWISE = ("G", "coherence", "random_error", "leakage", "resolution")  # by pair
CORRELATIONS = ("output_correlation", "input_correlation")
POINTWISE = ("omega", *PAIRWISE, *CORRELATIONS, "multiple_coherence", "condition")
HEAD = ("casid", "version", "digest")  # of a saved one, beside its fields
COMPLEX = ("G", *CORRELATIONS)
MOST = {"coherence": 1.0} | dict.fromkeys(PAIRWISE[2:], np.inf)
ROUNDING = 1e-9
FED_BACK = (
    "half or more of the response after {!r} may be noise that is fed back into it, or what no "
    "linear model follows (backlash, a rate limit), so it is left out (NaN): of feedback it would "
    "be the controller's inverse; which of both it is, distortion() tells by two amplitudes"
)
UNDRIVEN = (
    "the references hardly move {!r}, so its responses are left out (NaN): they would show only "
    "fed-back noise"
)


@storable
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class FrequencyResponse(Shown):
    """A non-parametric frequency response with its quality.

    Parameters
    ----------
    omega : (K,) array
        Frequencies [rad/s], increasing.
    G : (K, ny, nu) complex array
        Response; NaN where a pair was not measured.
    coherence : (K, ny, nu) array
        Partial coherence, in [0, 1]; NaN where a pair was not measured.
    random_error : (K, ny, nu) array
        Normalised random error of abs(G), one standard deviation; the same number is that of the
        phase in rad.
    leakage : (K, ny, nu) array
        What the windows' finite length, and noise that a controller feeds back, add to that error;
        zero unless given.
    resolution : (K, ny, nu) array
        Standard deviation [rad/s] of the spectral window: errors of points nearer than that are
        alike; zero, errors of all frequencies independent, unless given.
    output_correlation, input_correlation : (K, ny, ny), (K, nu, nu) complex array
        Correlation of the errors between outputs, which share noise, and between inputs, which
        moved together; none unless given.
    inputs, outputs : tuple of str
        Channel names.
    input_std, output_std : (nu,), (ny,) array
        Standard deviations of the channels over the records.
    multiple_coherence : (K, ny) array
        Share of each output's power that all inputs together explain; NaN if unknown.
    condition : (K,) array
        Condition number of the inputs' coherence matrix, 1 for uncorrelated inputs; NaN if unknown.
    windows : tuple of float
        Window lengths [s].
    flags : mapping
        Reason -> positions in ``omega`` of points to distrust.
    records : tuple of str
        Names of the records used.
    fingerprints : tuple of tuple of str
        Of these, by which they are recognised (`casid.fingerprints`).
    printed : tuple of (tuple of str, tuple of str)
        Inputs and outputs that each fingerprint is of; the response's own unless given.
    """

    omega: Array
    G: ComplexArray
    coherence: Array
    random_error: Array
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    input_std: Array
    output_std: Array
    leakage: Array = field(default_factory=lambda: np.zeros((0, 0, 0)))
    resolution: Array = field(default_factory=lambda: np.zeros((0, 0, 0)))
    output_correlation: ComplexArray = field(default_factory=lambda: np.zeros((0, 0, 0), complex))
    input_correlation: ComplexArray = field(default_factory=lambda: np.zeros((0, 0, 0), complex))
    multiple_coherence: Array = field(default_factory=lambda: np.zeros((0, 0)))
    condition: Array = field(default_factory=lambda: np.zeros(0))
    windows: tuple[float, ...] = ()
    flags: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    records: tuple[str, ...] = ()
    fingerprints: tuple[tuple[str, ...], ...] = ()
    printed: tuple[tuple[tuple[str, ...], tuple[str, ...]], ...] = ()

    def __post_init__(self) -> None:
        omega = np.array(self.omega, dtype=float)
        omega.setflags(write=False)
        object.__setattr__(self, "omega", omega)
        named: tuple[Any, ...] = (*self.outputs, *self.inputs)
        if wrong := [name for name in named if not isinstance(name, str)]:
            raise ValueError(f"{wrong[0]!r} is no name of a channel")
        K, ny, nu = len(omega), len(self.outputs), len(self.inputs)
        increasing = omega.ndim == 1 and K and (omega > 0).all() and (np.diff(omega) > 0).all()
        if not increasing or np.isinf(omega).any():
            raise ValueError("omega: expected increasing frequencies above 0 rad/s, (K,)")
        unless_given: dict[str, Array] = {
            "leakage": np.zeros((K, ny, nu)),
            "resolution": np.zeros((K, ny, nu)),
            "output_correlation": np.tile(np.eye(ny), (K, 1, 1)),
            "input_correlation": np.tile(np.eye(nu), (K, 1, 1)),
            "multiple_coherence": np.full((K, ny), np.nan),
            "condition": np.full(K, np.nan),
        }
        for name, values in unless_given.items():
            if not getattr(self, name).size:
                object.__setattr__(self, name, values)
        pairs = dict.fromkeys(PAIRWISE, (K, ny, nu))
        rest = {"input_std": (nu,), "output_std": (ny,), "multiple_coherence": (K, ny)}
        rest |= {"output_correlation": (K, ny, ny), "input_correlation": (K, nu, nu)}
        wanted: dict[str, tuple[int, ...]] = {**pairs, **rest, "condition": (K,)}
        for name, shape in wanted.items():
            values = np.array(getattr(self, name), dtype=complex if name in COMPLEX else float)
            values.setflags(write=False)
            object.__setattr__(self, name, values)
            if values.shape != shape:
                raise ValueError(
                    f"{name} has shape {values.shape}, expected {shape}: "
                    f"{K} frequencies, {ny} outputs, {nu} inputs"
                )
        self._refuse("G", np.isinf(self.G), "a finite number")
        for name, most in MOST.items():
            size = getattr(self, name)
            self._refuse(name, (size < 0) | (size > most * (1 + ROUNDING)), f"0 to {most:g}")

    def _refuse(self, name: str, wrong: BoolArray, wanted: str) -> None:
        """ValueError for values of points (K, ny, nu) that are ``wrong``."""
        for k, i, j in np.argwhere(wrong)[:1]:
            raise ValueError(
                f"{name} is {getattr(self, name)[k, i, j]:.4g} for {self.outputs[i]} from "
                f"{self.inputs[j]} at {self.omega[k]:.4g} rad/s, expected {wanted}, or NaN where "
                "it is not known"
            )

    def headline(self) -> str:
        """Channels, frequencies, how much of it is coherent."""
        usual = 100 * float(np.mean(self.coherence >= 0.6))
        return (
            f"{listed(self.outputs, 10)} from {listed(self.inputs)}, {len(self.omega)} frequencies "
            f"of {self.omega[0]:.3g} to {self.omega[-1]:.3g} rad/s, coherence of 0.6 or more in "
            f"{usual:.0f} %"
        )

    def flights(self) -> list[PrintedFlight]:
        """Name, fingerprint, inputs and outputs of every record that has a fingerprint."""
        own = self.printed or ((self.inputs, self.outputs),) * len(self.fingerprints)
        rows = zip(self.records, self.fingerprints, own, strict=False)
        return [(name, prints, *channels) for name, prints, channels in rows if prints]

    @property
    def error(self) -> Array:
        """Deviation of abs(G), relative, and of the phase [rad]: noise and leakage."""
        return np.asarray(np.hypot(self.random_error, self.leakage))

    def index(self, output: str, input: str) -> tuple[int, int]:
        """Row and column of one pair."""
        if output not in self.outputs or input not in self.inputs:
            raise ValueError(
                f"no pair ({output!r}, {input!r}): outputs are {', '.join(self.outputs)}, "
                f"inputs are {', '.join(self.inputs)}"
            )
        return self.outputs.index(output), self.inputs.index(input)

    def between(self, low: float, high: float) -> "FrequencyResponse":
        """Return the points with low <= omega <= high [rad/s]."""
        keep = (self.omega >= low * (1 - 1e-9)) & (self.omega <= high * (1 + 1e-9))
        if not keep.any():
            raise ValueError(
                f"no point between {low:g} and {high:g} rad/s; the response spans "
                f"{self.omega[0]:g} to {self.omega[-1]:g} rad/s"
            )
        return self.take(np.flatnonzero(keep))

    def take(self, index: Sequence[int] | NDArray[np.intp]) -> "FrequencyResponse":
        """Return the points at these positions in ``omega``, in increasing order."""
        place = {int(old): new for new, old in enumerate(index)}
        flags = {why: tuple(place[k] for k in at if k in place) for why, at in self.flags.items()}
        arrays = {name: getattr(self, name)[list(place)] for name in POINTWISE}
        return replace(self, **arrays, flags={why: at for why, at in flags.items() if at})

    def save(self, path: str | Path) -> None:
        """Write the response as JSON, whole or not at all."""
        content: dict[str, Any] = {name: getattr(self, name) for name in self.__dataclass_fields__}
        for name in COMPLEX:
            values = getattr(self, name)
            content[name] = {"real": values.real, "imag": values.imag}
        write_result(path, {"casid": "frequency response", "version": 1} | content)

    @classmethod
    def load(cls, path: str | Path) -> "FrequencyResponse":
        """Read what `save` wrote, or what a study left in ``stages/frequency.json``.

        Raises
        ------
        ValueError
            No frequency response, a damaged one, or a file that was changed.
        """
        content = read_json(path)
        kind = content.get("casid")
        if kind not in ("frequency response", "result"):
            raise ValueError(
                f"{path}: not a frequency response saved by casid; a study leaves one in "
                "stages/frequency.json"
            )
        check_digest(content, path)
        try:
            found = decode(content["result"]) if kind == "result" else cls._from_content(content)
        except DAMAGED as error:
            raise ValueError(
                f"{path}: the frequency response in it is damaged ({error}); save it again"
            ) from error
        if not isinstance(found, cls):
            raise ValueError(  # noqa: TRY004 - the file's fault
                f"{path}: a {type(found).__name__}, no frequency response; a study leaves that in "
                "stages/frequency.json"
            )
        return found

    @classmethod
    def _from_content(cls, content: dict[str, Any]) -> "FrequencyResponse":
        content = {name: part for name, part in content.items() if name not in HEAD}
        for name in COMPLEX:
            if parts := content.get(name):
                real, imag = (np.array(parts[half], dtype=float) for half in ("real", "imag"))
                content[name] = real + 1j * imag
        if prints := content.get("fingerprints"):
            content["fingerprints"] = tuple(map(tuple, prints))
        content["printed"] = tuple((tuple(u), tuple(y)) for u, y in content.get("printed", ()))
        for name in ("inputs", "outputs", "windows", "records"):
            content[name] = tuple(content[name])
        content["flags"] = {why: tuple(at) for why, at in content["flags"].items()}
        content |= {k: np.array(v, dtype=float) for k, v in content.items() if isinstance(v, list)}
        return cls(**content)

    def to_control(self) -> Any:  # noqa: ANN401 - python-control has no types
        """The response as a `control.FrequencyResponseData`, without its quality."""
        import control  # noqa: PLC0415 - slow to import, and only wanted here

        names = {"inputs": list(self.inputs), "outputs": list(self.outputs)}
        return control.FrequencyResponseData(np.moveaxis(self.G, 0, 2), self.omega, **names)


def response_of_pair(
    target: FrequencyResponse | Sequence[FrequencyResponse], pair: tuple[str, str]
) -> FrequencyResponse:
    """The first of several responses in which a pair was measured; else the first of all."""
    responses = several(target)
    for each in responses:
        if pair[0] in each.outputs and pair[1] in each.inputs:
            i, j = each.index(*pair)
            if np.isfinite(each.G[:, i, j]).any():
                return each
    return responses[0]
