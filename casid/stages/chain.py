"""The stages up to output error as one estimator.

M. Bergamasco, M. Lovera, "Rotorcraft system identification: a time/frequency domain approach",
section 3: records to a black box (3.2), black box to structure (3.3), refinement on records (3.4).
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from casid.fit import AnyFit, Fit
from casid.model import Bounds, M, Model
from casid.record import Record
from casid.records import several
from casid.shooting.precision import OutputErrorNotes
from casid.stages.black_box import BLACK_BOX
from casid.stages.matching import HINF, QUADRATIC
from casid.stages.refinement import OUTPUT_ERROR
from casid.stages.spectra import FREQUENCY
from casid.stages.stage import Role, Stage, Task, run_stages
from casid.subspace.pbsid import BlackBox

CHAIN: tuple[Stage, ...] = (BLACK_BOX, FREQUENCY, QUADRATIC, HINF, OUTPUT_ERROR)


@dataclass(frozen=True, eq=False, kw_only=True)
class Chain:
    """All stages up to output error as one estimator.

    Parameters
    ----------
    settings
        As in `identify`.
    black_box : BlackBox
        Instead of one from the records.
    refinement, sweeps : sequence of Record
        As in `identify`.
    """

    settings: Mapping[str, Any] = field(default_factory=dict)
    black_box: BlackBox | None = None
    refinement: tuple[Record, ...] = ()
    sweeps: tuple[Record, ...] = ()

    def prepared(
        self,
        model: Model,  # noqa: ARG002 - the black box knows of none
        data: Record | Sequence[Record],
        *,
        fixed: Collection[str] = (),  # noqa: ARG002
        bounds: Bounds | None = None,  # noqa: ARG002
    ) -> "Chain":
        """The same with its black box estimated: many fits to the same records share it."""
        if self.black_box is not None:
            return self
        own = self.settings.get(BLACK_BOX.table, BLACK_BOX.settings)
        return replace(self, black_box=own.fit(several(data)))

    def fit(
        self,
        model: M,
        data: Record | Sequence[Record],
        *,
        fixed: Collection[str] = (),
        bounds: Bounds | None = None,
        near: AnyFit | None = None,  # noqa: ARG002 - the stages before lead elsewhere
    ) -> Fit[M, OutputErrorNotes]:
        """The refined fit of `identify`."""
        roles: dict[Role, tuple[Record, ...]] = {
            "identification": several(data),
            "frequency": self.sweeps,
            "refinement": self.refinement,
        }
        held: Any = {"fixed": fixed, "bounds": bounds}
        task = Task(model=model, roles=roles, stages=CHAIN, settings=self.settings, **held)
        known = {} if self.black_box is None else {"pbsid": self.black_box}
        found: Fit[M, OutputErrorNotes] = run_stages(task, known=known).results["output_error"]
        return found
