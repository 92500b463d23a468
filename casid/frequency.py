"""Frequency responses estimated from records."""

from dataclasses import dataclass

from casid.arrays import Array, ComplexArray


@dataclass(frozen=True, eq=False, kw_only=True)
class FrequencyResponse:
    """A non-parametric frequency response with its quality.

    Parameters
    ----------
    omega : (K,) array
        Frequencies [rad/s].
    G : (K, ny, nu) complex array
        Response; NaN where a pair was not measured.
    coherence : (K, ny, nu) array
        Partial coherence, in [0, 1].
    random_error : (K, ny, nu) array
        Normalised random error of abs(G), one standard deviation.
    inputs, outputs : tuple of str
        Channel names.
    input_std, output_std : (nu,), (ny,) array
        Standard deviations of the channels over the records.
    """

    omega: Array
    G: ComplexArray
    coherence: Array
    random_error: Array
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    input_std: Array
    output_std: Array
