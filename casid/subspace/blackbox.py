"""The black box: an unstructured model with what is known about it."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from casid.arrays import Array, BoolArray, ComplexArray
from casid.checks import check_fields
from casid.display import Shown, counted
from casid.excitations import Excitation
from casid.linear import StateSpace, from_zoh
from casid.record import Hold
from casid.subspace.candidates import OrderSelection
from casid.subspace.columns import Segment
from casid.subspace.held_inputs import discretised, undiscretised
from casid.subspace.prediction import SampledUncertainty
from casid.subspace.refinement import ResponseUncertainty
from casid.subspace.trust import Missed, data_doubts, growth_doubts, order_doubts
from casid.textfile import read_json, write_result
from casid.values import DAMAGED, check_digest, decode, encode, storable

IMAGES = 3  # on either side that are looked at
GRID = 100  # frequencies


@storable
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class BlackBox(Shown):
    """An unstructured model in innovation form, with the settings that gave it.

    Parameters
    ----------
    system : StateSpace
        Continuous (``dt`` None) from Laguerre-projected data, discrete from the samples themselves.
    K : (nx, ny) array
        Innovation gain, continuous or discrete as ``system``; A - KC is stable.
    singular_values : array
        Of the predicted future; their drop suggests the order.
    pole : float
        The Laguerre pole a [rad/s]; NaN for ``transform="none"``.
    past, future : int
        Window lengths.
    transform : {"laguerre", "none"}
        What the data went through.
    feedthrough : (ny, nu) bool array
        Where the direct term was free.
    input_std, output_std : (nu,), (ny,) array
        Standard deviations of the channels over the records.
    band : (float, float)
        Frequencies [rad/s] in which the records excite the aircraft and the model means something.
    records : tuple of str
        Names of the records used.
    regularisation : float
        Tikhonov factor of the regression, relative to its largest singular value.
    segments : tuple of Segment
        What was used of each record, and how many missing samples were interpolated.
    uncertainty : ResponseUncertainty, SampledUncertainty or None
        Covariance of a black box refined to maximum likelihood; see `response_std`.
    selection : OrderSelection or None
        How the settings were chosen from data, if they were.
    explained : (ny,) array or None
        Share of each output's power explained at a typical frequency of the band; None unless
        refined by Fourier transforms.
    doubtful : complex array
        Growing modes that the likelihood does not need, on which the records do not agree or which
        causal prediction, the start, or a model of one state less does not find (these two are not
        asked of prediction errors). Those so slow that growth and decay look alike: see `Pbsid`.
    missed : Missed or None
        Where a model of two more states leaves clearly less of an output.
    refinement : str
        What followed the subspace estimate: "unrefined", "fourier" on projections, "prediction"
        where noise fed back would have biased that; on samples "linear", "prediction",
        "simulation" or "local simulation", see `Pbsid`.
    hold : {"foh", "zoh"}
        What the inputs do between samples.
    interval : float or None
        Sampling interval of the records [s], if it is known.
    excitation : Excitation or None
        How much of the inputs came from outside; None of records too short to tell.
    remarks : tuple of str
        What is wrong with the records themselves: stretches that were not measured, a channel that
        disagrees with the other records, noise fed back that biases this black box.
    biased : bool
        Whether noise fed back may: then it is no measure of a structure.
    """

    system: StateSpace
    K: Array
    singular_values: Array
    pole: float
    past: int
    future: int
    transform: str
    feedthrough: BoolArray
    input_std: Array
    output_std: Array
    band: tuple[float, float]
    records: tuple[str, ...]
    regularisation: float = 0.0
    segments: tuple[Segment, ...] = ()
    uncertainty: ResponseUncertainty | SampledUncertainty | None = None
    selection: OrderSelection | None = None
    explained: Array | None = None
    doubtful: ComplexArray = field(default_factory=lambda: np.zeros(0, dtype=complex))
    missed: Missed | None = None
    refinement: str = "unrefined"
    hold: Hold = "zoh"
    excitation: Excitation | None = None
    remarks: tuple[str, ...] = ()
    interval: float | None = None
    biased: bool = False

    def headline(self) -> str:
        """Order, band, where it comes from, what is doubtful."""
        kind = "continuous" if self.system.dt is None else f"discrete, {self.system.dt:.4g} s"
        doubts = self.doubts()
        return (
            f"order {self.order}, {kind}, {counted(len(self.system.outputs), 'output')} from "
            f"{counted(len(self.system.inputs), 'input')}, {self.band[0]:.3g} to "
            f"{self.band[1]:.3g} rad/s, {self.refinement}, {counted(len(self.records), 'record')}"
            + (f"; doubtful: {'; '.join(doubts)}" if doubts else "")
        )

    def save(self, path: str | Path) -> None:
        """Write it as JSON, whole or not at all."""
        write_result(path, {"casid": "black box", "version": 1, "result": encode(self)})

    @classmethod
    def load(cls, path: str | Path) -> "BlackBox":
        """Read what `save` wrote, or what a study left in ``stages/pbsid.json``.

        Raises
        ------
        ValueError
            No black box, a damaged one, or a file that was changed.
        """
        content = read_json(path)
        check_digest(content, path)
        try:
            found = decode(content["result"])
        except DAMAGED as error:
            raise ValueError(f"{path}: not a black box saved by casid ({error!r})") from error
        if not isinstance(found, cls):
            raise ValueError(f"{path}: a {type(found).__name__}, expected a black box")  # noqa: TRY004
        try:
            _check(found)
        except ValueError as error:
            raise ValueError(f"{path}: {error}; was the file edited?") from error
        return found

    def doubts(self) -> tuple[str, ...]:
        """Why records do not support a model, a mode of it or its order; empty where they do."""
        # Empty, too, where it is not known: without refinement to maximum likelihood.
        outside = () if self.excitation is None else self.excitation.doubts()
        growth = growth_doubts(self.doubtful)
        doubts = (*self.remarks, *outside, *growth, *order_doubts(self.missed, self.order))
        return (*self.unsupported(), *doubts)

    @property
    def measures(self) -> bool:
        """Whether a structure may be measured by it: its errors are known and hold."""
        return self.uncertainty is not None and not self.missed and not self.biased

    def unsupported(self) -> tuple[str, ...]:
        """Why records do not support any model; empty where they do, or where it is not known."""
        return () if self.explained is None else data_doubts(self.explained, self.system.outputs)

    def fed_back(self) -> tuple[str, ...]:
        """Outputs that inputs make most of which outputs feed back: see `Excitation.fed_back`.

        That such a black box, rather the controller's inverse, predicts them is no merit.
        """
        if self.excitation is None:
            return ()
        low, high = self.band
        omega = np.geomspace(max(low, high / GRID), high, GRID)
        power = np.abs(self.system.response(omega) * self.input_std) ** 2  # (K, ny, nu)
        back = power * self.excitation.fed_back(self.system.inputs, omega)[:, None]
        mostly = back.sum(axis=(0, 2)) > power.sum(axis=(0, 2)) / 2
        return tuple(np.array(self.system.outputs)[mostly].tolist())

    def response(self, omega: Array) -> ComplexArray:
        """G (K, ny, nu) to inputs that are not held: of a discrete black box without its hold.

        Exact but for what goes on beyond half the sampling frequency, see `images`.
        """
        G = self.system.response(omega)
        if self.system.dt is None:
            return G
        held = passed(omega, self.system.dt, self.hold)
        if self.hold == "foh":
            return np.asarray(G / held)
        direct = self.system.D * np.exp(-1j * np.asarray(omega)[:, None, None] * self.system.delay)
        return np.asarray((G - direct) / held + direct)

    def images(self, omega: Array) -> Array:
        """How far samples leave the response open, (K, ny, nu), as held inputs have images.

        Samples show the sum of G at ω and at ω + 2πk/h, weighted by what the hold passes: ω over
        ω + 2πk/h, squared for inputs in straight lines. There G is taken to be 3 dB below that at a
        quarter of the sampling frequency, of any phase, and so is that of a model of the samples.

        A direct term passes all images of a staircase, which delayed by whole samples are in phase:
        the samples are those of any delay up to one sample less. Where one is free, its images are
        those of as much as G is at that frequency, and the model's are its own.
        """
        omega = np.asarray(omega, dtype=float)
        if not self.interval:
            return np.zeros((len(omega), len(self.system.outputs), len(self.system.inputs)))
        power, rate = (1 if self.hold == "zoh" else 2), 2 * np.pi / self.interval
        k = np.delete(np.arange(-IMAGES, IMAGES + 1), IMAGES)
        share = (omega[:, None] / np.abs(omega[:, None] + k * rate)) ** power
        beyond = np.abs(self.response(np.array([rate / 4])))
        left = np.linalg.norm(share, axis=1)[:, None, None] * beyond
        if self.hold == "foh":
            return np.asarray(left)
        held = passed(omega, self.interval, "zoh")
        sampled = self.system if self.system.dt else discretised(self.system, self.interval, "zoh")
        own = np.abs(sampled.response(omega) / held - self.response(omega))
        direct = np.hypot(np.abs(1 / held - 1) * beyond, own)
        return np.asarray(np.where(self.feedthrough, np.maximum(direct, left), left))

    def response_std(self, omega: Array) -> tuple[Array, Array]:
        """Relative standard deviation of abs(G) and standard deviation of its phase [rad].

        Both (K, ny, nu). They hold what noise, and whatever else the linear model cannot follow,
        does to the estimate of a model of this order; not the error of a wrong order.

        Raises
        ------
        ValueError
            The black box was not refined, or not to maximum likelihood.
        """
        F = self.response_factor(omega)
        return np.linalg.norm(F.real, axis=-1), np.linalg.norm(F.imag, axis=-1)

    def response_factor(self, omega: Array) -> ComplexArray:
        """F (K, ny, nu, rank) of the errors of ln G: those of all pairs and frequencies together.

        The estimate is off by F z, z independent standard normal numbers.

        Raises
        ------
        ValueError
            As `response_std`.
        """
        if self.uncertainty is None:
            raise ValueError(
                f"this black box ({self.refinement}) has no uncertainty: only one refined to "
                'maximum likelihood has; call pbsid with refine=True and transform="laguerre"'
            )
        return self.uncertainty.response_factor(np.asarray(omega, dtype=float))

    @property
    def order(self) -> int:
        """Number of states."""
        return self.system.nx

    def continuous(self) -> "BlackBox":
        """The continuous equivalent of a discrete black box, for its inputs' hold.

        The gain brings A - KC as near as it can to the logarithm of the discrete predictor's.

        Raises
        ------
        ValueError
            A discrete pole on the negative real axis, which has no continuous equivalent.
        """
        system = self.system
        if system.dt is None:
            return self
        found = undiscretised(system, self.hold)
        predictor, _ = from_zoh(system.A - self.K @ system.C, system.B, system.dt)
        K = np.linalg.lstsq(system.C.T, (found.A - predictor).T, rcond=None)[0].T
        return replace(self, system=found, K=K)


def passed(omega: Array, h: float, hold: Hold) -> ComplexArray:
    """What a hold of inputs over ``h`` [s] passes of them at frequencies (K,), (K, 1, 1)."""
    half = np.asarray(omega)[:, None, None] * h / 2
    lag = np.sinc(half / np.pi)
    return np.asarray(lag**2 + 0j if hold == "foh" else lag * np.exp(-1j * half))


def _check(box: BlackBox) -> None:
    """Refuse fields of another kind, shape or range than those of a black box."""
    sampled = box.transform == "none"  # has no Laguerre pole
    check_fields(replace(box, pole=0.0) if sampled else box)
    system = box.system
    nx, nu, ny = system.nx, system.nu, system.ny
    shapes = {"K": (nx, ny), "feedthrough": (ny, nu), "input_std": (nu,), "output_std": (ny,)}
    shapes |= {"explained": (ny,)} if box.explained is not None else {}
    for name, shape in shapes.items():
        value = np.asarray(getattr(box, name))
        if value.shape != shape or (name != "explained" and not np.isfinite(value).all()):
            raise ValueError(f"{name} of shape {value.shape}, expected {shape}, all of it finite")
    for letter in "ABCD":
        if not np.isfinite(getattr(system, letter)).all():
            raise ValueError(f"system: {letter} is not finite")
    for name in ("input_std", "output_std"):
        if (getattr(box, name) < 0).any():
            raise ValueError(f"{name} = {getattr(box, name)}, expected 0 or more")
    if not 0 <= box.band[0] < box.band[1] < np.inf:
        raise ValueError(f"band = {box.band}, expected 0 <= lowest < highest [rad/s]")
