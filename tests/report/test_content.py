"""What a report is made of."""

from pathlib import Path

import jinja2
import pytest
from truths.structures import SECOND, Lag, black_box

from casid import match
from casid.report import Content
from casid.report.content import TEMPLATES, template


def test_structured_models_are_told_from_the_others():
    box = black_box(SECOND)
    fit = match(Lag(), box)
    page = Content(
        title="", model=Lag(), results={}, models={"black box": box, "match": fit},
        model_file=Path("lag.py"), model_digest="",
    )  # fmt: skip
    assert page.fits == {"match": fit}
    assert page.structure is Lag
    assert page.units["p"] == "rad/s"


@pytest.mark.parametrize("name", [file.name for file in TEMPLATES.glob("*.html.j2")])
def test_templates_are_found_by_name_and_parse(name):
    text = template(name.removesuffix(".html.j2"))
    assert text == (TEMPLATES / name).read_text(encoding="utf-8")
    assert jinja2.Environment(autoescape=True).parse(text).body
