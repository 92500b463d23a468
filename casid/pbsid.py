"""Predictor-based subspace identification of a continuous-time black box."""

from dataclasses import dataclass

from casid.arrays import Array, BoolArray
from casid.linear import StateSpace


@dataclass(frozen=True, eq=False, kw_only=True)
class BlackBox:
    """An unstructured model in innovation form, with the settings that gave it.

    Parameters
    ----------
    system : StateSpace
        Continuous (``dt`` None) from Laguerre-projected data, discrete from the samples themselves.
    K : (nx, ny) array
        Innovation gain, continuous or discrete as ``system``.
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
