"""What a report is made of."""

from dataclasses import replace

import jinja2
import pytest
from truths.structures import SECOND, Lag, black_box

from casid import match, mode_bands, structure_error
from casid.report import Caution, Content, Section
from casid.report.content import TEMPLATES, cautions, leads, section
from casid.subspace.trust import Missed


def test_structured_models_are_told_from_the_others():
    box = black_box(SECOND)
    fit = match(Lag(), box)
    page = Content(
        title="", model=Lag(), results={}, models={"black box": box, "match": fit},
        model_files={},
    )  # fmt: skip
    assert page.fits == {"match": fit}
    assert page.structure is Lag
    assert page.units["p"] == "rad/s"


@pytest.mark.parametrize("name", [file.name for file in TEMPLATES.glob("*.html.j2")])
def test_a_section_has_the_template_of_its_name_and_knows_its_result(name):
    made = section(name.removesuffix(".html.j2"), "Title", 7, 3, values={"more": 4}, lead="Lead.")
    assert made.template == (TEMPLATES / name).read_text(encoding="utf-8")
    assert jinja2.Environment(autoescape=True).parse(made.template).body
    assert (made.title, made.place, made.lead) == ("Title", 7, "Lead.")
    assert made.values == {"found": 3, "more": 4}


def test_praise_is_told_only_where_no_caution_contradicts_it():
    praised = Section(name="a", lead="It misses nothing.", praise=True)
    plain = Section(name="b", lead="It was made.", cautions=(Caution("Look at bounds.", 10),))
    assert leads([praised, plain]) == ("It misses nothing.", "It was made.")
    for rank in (3, 5, 7):
        worse = Section(name="c", cautions=(Caution("Model and data disagree.", rank),))
        assert leads([praised, plain, worse]) == ("It was made.",)


def test_a_caution_that_is_warned_of_and_shown_is_told_once():
    page = Content(
        title="", model=Lag(), results={}, models={}, model_files={},
        warnings=("it may be biased", "look at bounds"),
    )  # fmt: skip
    shown = Section(name="c", cautions=(Caution("It may be biased.", 30),))
    assert cautions(page, [shown]) == ("It may be biased.", "look at bounds")


@pytest.mark.slow
def test_modes_are_stated_with_what_the_black_box_says_that_structures_miss(content, page):
    fit, box = content.fits["output error"], content.results["pbsid"]
    alone = replace(content, results={})
    assert alone.bands["output error"] == mode_bands(fit)
    beside = mode_bands(fit, error=structure_error(fit, box))
    assert content.bands["output error"] == beside != mode_bands(fit)
    assert "a nearby mode of the black box" in page.read_text(encoding="utf-8")
    other = replace(box, system=replace(box.system, outputs=("q", *box.system.outputs[1:])))
    poor = replace(
        box, missed=Missed(output="p", omega=3.0, ratio=2.0, order=8)
    )  # what its order misses is in its poles
    for told in (other, poor, replace(box, uncertainty=None)):
        assert replace(content, results={"pbsid": told}).missed == {}
