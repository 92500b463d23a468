"""The list of stages."""

from casid.report import Section
from casid.stages.listing import STAGES, sections, stages_in_words, tables_of_stages
from casid.stages.stage import Stage


def test_names_and_tables_of_stages_are_their_own():
    names = [stage.name for stage in STAGES]
    assert len(set(names)) == len(names)
    for k, stage in enumerate(STAGES):
        assert set(stage.needs) | set(stage.uses) <= set(names[:k])
        assert (stage.settings is None) == (stage.table == "")


def test_readers_are_told_every_stage_of_an_identification_and_every_table_once():
    said = stages_in_words(STAGES).split(", ")
    assert said == [stage.does for stage in STAGES if stage.command == ""]
    tables = tables_of_stages(STAGES).split(", ")
    assert len(tables) == len(set(tables))
    assert set(tables) == {f"[{stage.table}]" for stage in STAGES if stage.table}


def test_sections_stand_in_the_order_of_the_stages_that_found_something():
    def stage(name):
        def show(found, _):
            return [Section(name=f"{name} {k}") for k in range(found)]

        return Stage(name=name, does="", run=lambda *_: None, show=show)

    shown = sections([stage(name) for name in "abc"], {"c": 1, "a": 2}, None)
    assert [each.name for each in shown] == ["a 0", "a 1", "c 0"]
