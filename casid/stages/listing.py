"""All stages, in their order: the one list that everything about stages is read from."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from casid.report.content import Content, Section
from casid.stages.baseline import BASELINE
from casid.stages.chain import CHAIN
from casid.stages.checking import CHECKED, STATES
from casid.stages.choice import CHOICE, CHOSEN
from casid.stages.comparison import COMPARISON
from casid.stages.conditions import CONDITIONS
from casid.stages.consistency import KINEMATICS
from casid.stages.judgement import VALIDATION
from casid.stages.qualification import QUALIFICATION
from casid.stages.stage import Stage
from casid.stages.sufficiency import SUFFICIENCY

STAGES: tuple[Stage, ...] = (
    KINEMATICS,
    *CHAIN,
    CHECKED,
    SUFFICIENCY,
    BASELINE,
    CHOICE,
    CHOSEN,
    CONDITIONS,
    VALIDATION,
    STATES,
    QUALIFICATION,
    COMPARISON,
)


def sections(stages: Iterable[Stage], results: Mapping[str, Any], page: Content) -> list[Section]:
    """What the stages show of their results, in the order of the stages."""
    found: Sequence[Stage] = [stage for stage in stages if stage.name in results]
    return [each for stage in found for each in stage.show(results[stage.name], page)]


def stages_in_words(stages: Iterable[Stage]) -> str:
    """What the stages of an identification do, one after the other, for a reader."""
    return ", ".join(stage.does for stage in stages if not stage.command)


def tables_of_stages(stages: Iterable[Stage]) -> str:
    """Tables of a study that hold the stages' settings, for a reader."""
    return ", ".join(dict.fromkeys(f"[{stage.table}]" for stage in stages if stage.table))
