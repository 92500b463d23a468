"""Last steps of the chain as estimators from the same manoeuvres, to be compared by prediction."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast

from casid.checks import checked_fields
from casid.fit import AnyFit, Fit
from casid.frequency.estimation import SpectralAnalysis
from casid.matching.match import Match
from casid.model import Bounds, M
from casid.record import Record
from casid.records import several
from casid.shooting.output_error import OutputError
from casid.subspace.pbsid import Pbsid


@checked_fields
@dataclass(frozen=True, eq=False, kw_only=True)
class LastStep:
    """An estimator, and what of the manoeuvres it takes in which form.

    Those that do not enter as time histories become a frequency response in the same likelihood, if
    ``responses`` says how, or do not enter.
    """

    estimator: OutputError | Match  # a match is to a black box of all manoeuvres
    histories: Collection[str] | None = None  # names of time histories; all unless given
    responses: SpectralAnalysis | None = None
    decimate: int = 1  # every how many samples of a time history are taken
    black_box: Pbsid = field(default_factory=Pbsid)  # how a match's black box is identified

    def fit(
        self,
        model: M,
        data: Record | Sequence[Record],
        *,
        fixed: Collection[str] = (),
        bounds: Bounds | None = None,
        near: AnyFit | None = None,
    ) -> Fit[M, Any]:
        """The estimate from these manoeuvres, or what is there of them."""
        records, held = several(data), cast("Any", {"fixed": fixed, "bounds": bounds})
        if isinstance(self.estimator, Match):
            return self.estimator.fit(model, self.black_box.fit(records), **held)
        own = [each for each in records if self.histories is None or each.name in self.histories]
        others = [each for each in records if each not in own]
        estimator = self.estimator
        if self.responses is not None and others:
            measured = (*estimator.responses, self.responses.fit(others))
            estimator = replace(estimator, responses=measured)
        return estimator.fit(
            model, [each.decimate(self.decimate) for each in own], **held, near=near
        )
