"""Public names: all there, and none imported before it is used."""

import inspect
import subprocess
import sys

import casid


def test_every_public_name_is_there():
    found = {name: getattr(casid, name) for name in casid.__all__}
    assert len(found) > 60
    assert casid.match is found["match"]
    assert set(dir(casid)) == set(found)
    assert not hasattr(casid, "no_such_name")


def test_public_functions_name_their_data_alike_and_take_eight_things_beside_them():
    data = {
        "model",
        "models",
        "fit",
        "records",
        "target",
        "data",
        "path",
        "study",
        "frame",
        "priors",
        "responses",
    }
    for name in casid.__all__:
        each = getattr(casid, name)
        if inspect.isfunction(each):
            parameters = list(inspect.signature(each).parameters)
            assert len([p for p in parameters if p not in data]) <= 8, name
            assert not {"frf", "options"} & set(parameters), name


def test_the_package_alone_loads_no_numerical_library():
    code = "import casid, sys; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"numpy", "scipy", "casadi", "matplotlib", "plotly"} & set(run.stdout.split())


def test_a_record_loads_neither_casadi_nor_what_draws():
    code = "from casid import Record, read_csv; import sys; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    found = set(run.stdout.split())
    assert "casid.record" in found
    assert not {"casadi", "matplotlib", "plotly", "scipy.signal"} & found
