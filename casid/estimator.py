"""What every estimator is: a frozen value of its settings, with one way to fit."""

from collections.abc import Collection
from typing import Any, Protocol

from casid.fit import AnyFit, Fit
from casid.model import Bounds, M


class Estimator(Protocol):
    """Estimates a structure's parameters from data; all settings are its fields."""

    def fit(
        self,
        model: M,
        data: Any,  # noqa: ANN401 - each estimator says what it takes
        *,
        fixed: Collection[str] = (),
        bounds: Bounds | None = None,
        near: AnyFit | None = None,
    ) -> Fit[M, Any]:
        """Estimate the free parameters of a model from data.

        Parameters
        ----------
        model : Model
            Structure and start.
        data
            Records or targets, one or several alike.
        fixed : collection of str
            Parameters held at the model's values.
        bounds : mapping
            ``{name: (lower, upper)}`` instead of the model file's.
        near : Fit
            Of the same data to a neighbouring problem (other bounds, one parameter held): a start
            that may save time.

        Raises
        ------
        ValueError, ModelError
            Data or a structure that cannot be used.
        ConvergenceError
            No solution; ``best`` is the best iterate.
        """
        ...
