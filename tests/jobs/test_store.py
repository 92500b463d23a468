"""Results on disk: what comes back, and what is computed again."""

import json

import numpy as np
import pytest
from truths.mixture import Mixture, record

from casid import DataWarning, output_error
from casid.jobs.store import Done, Store
from casid.values import content_digest


def test_a_result_comes_back_with_all_that_is_said_of_it(tmp_path):
    store = Store(tmp_path / "new", (Mixture,))
    fit = output_error(Mixture(), record())
    store.put("fit", "k", Done(result=fit, seconds=1.5, warnings=("few data",), source="free"))
    back = store.get("fit", "k")
    assert (back.reason, back.seconds, back.warnings, back.source, back.kept) == (
        "", 1.5, ("few data",), "free", True,
    )  # fmt: skip
    assert back.result.model == fit.model
    np.testing.assert_array_equal(back.result.covariance, fit.covariance)
    assert store.get("fit", "other key") is None
    assert store.get("nothing", "k") is None
    assert Store(tmp_path / "new").get("fit", "k") is None  # the structure is not known


@pytest.mark.parametrize("damage", [
    "{", "[]", "{}", '{"casid": "result", "key": "k"}',
    '{"casid": "result", "key": "k", "reason": "", "seconds": 1, "warnings": [], "source": "", '
    '"result": {"value": "os:system", "fields": {"command": "true"}}, "digest": "DIGEST"}',
])  # fmt: skip
def test_a_damaged_file_or_that_of_another_version_is_not_taken(damage, tmp_path):
    store = Store(tmp_path)
    if "DIGEST" in damage:
        damage = damage.replace("DIGEST", content_digest(json.loads(damage)))
    (tmp_path / "pbsid.json").write_text(damage, encoding="utf-8")
    assert store.get("pbsid", "k") is None


def test_a_digit_changed_in_a_kept_result_is_seen_and_told(tmp_path):
    store, found = Store(tmp_path), {"x": np.array([-4.0057, np.nan, np.inf, -0.0, 1e-300, 1 / 3])}
    store.put("output_error", "k", Done(result=found, seconds=1.0))
    np.testing.assert_array_equal(store.get("output_error", "k").result["x"], found["x"])
    text = store.path("output_error").read_text(encoding="utf-8")
    store.path("output_error").write_text(text.replace("-4.0057", "-9.0057"), encoding="utf-8")
    with pytest.warns(DataWarning, match=r"output_error\.json was changed .* computed again"):
        assert store.get("output_error", "k") is None


def test_without_a_folder_nothing_is_kept():
    store = Store(None)
    store.put("a", "k", Done(result=1.0))
    assert store.get("a", "k") is None


def test_names_that_look_alike_have_files_of_their_own(tmp_path):
    store = Store(tmp_path)
    paths = {store.path(name) for name in ("±20 %", "+20 %", "Free", "free", "a/../b", "a" * 90)}
    assert len({path.name.lower() for path in paths}) == 6
    assert all(path.parent == tmp_path for path in paths)
    assert store.path("output_error").name == "output_error.json"


def test_files_are_json_that_others_read(tmp_path):
    Store(tmp_path).put("a", "k", Done(result={"x": np.array([1.0, np.inf])}, reason="halfway"))
    content = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    assert (content["casid"], content["key"], content["reason"]) == ("result", "k", "halfway")
