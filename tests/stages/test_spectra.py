"""The stage of the measured frequency response."""

import numpy as np
import pytest
from truths.closed_roll import TRUTH, noisy

from casid import DataWarning, Record, SpectralAnalysis, frequency_response
from casid.stages.spectra import FREQUENCY
from casid.stages.stage import Task, run_stages


def test_the_stage_measures_the_sweeps_alone_with_its_own_settings():
    sweeps, others = (noisy(1),), (noisy(2),)
    own = SpectralAnalysis(omega=np.geomspace(6.0, 15.0, 7))
    roles = {"identification": others, "frequency": sweeps}
    task = Task(model=TRUTH, roles=roles, stages=(FREQUENCY,), settings={"frequency": own})
    found = run_stages(task).results["frequency"]
    direct = frequency_response(sweeps, omega=own.omega)
    np.testing.assert_array_equal(found.G, direct.G)
    assert len(found.omega) == 7
    without = Task(model=TRUTH, roles={"identification": others}, stages=(FREQUENCY,))
    assert run_stages(without).results == {}


@pytest.mark.second
def test_a_check_channel_serves_as_the_reference_of_a_loop():
    N = 15000
    rng, t = np.random.default_rng(0), 0.02 * np.arange(N)
    r, v = np.array([[3.0], [1.0]]) * rng.standard_normal((2, N // 10)).repeat(10, axis=1)
    y, u = np.zeros(N), np.zeros(N)
    for k in range(N - 1):  # y' = -2 y + 10 (u + v), u = r - y
        u[k] = r[k] - y[k]
        y[k + 1] = y[k] + 0.2 * (u[k] + v[k] - 0.2 * y[k])
    whole = Record(t, u[:, None], np.column_stack([y, r]), ("lat",), ("p", "r_lat"), "loop", "zoh")
    plain = whole.select(outputs=["p"])
    own = SpectralAnalysis(
        omega=np.geomspace(1.5, 8.0, 9), windows=(10.0, 15.0), reference=("r_lat",)
    )
    roles, checks = {"frequency": (plain,)}, {"frequency": (whole,)}
    given = {"stages": (FREQUENCY,), "settings": {"frequency": own}}
    found = run_stages(Task(model=TRUTH, roles=roles, checks=checks, **given)).results["frequency"]
    assert (found.inputs, found.outputs) == (("lat",), ("p",))
    direct = own.fit([whole])
    np.testing.assert_array_equal(found.G, direct.G)
    true = 10 / (1j * own.omega + 2)
    # Without the reference v, a third of r, comes in by y = G (u + v), u = r - y:
    fed_back = true * (9 - true.conj()) / (9 + np.abs(true) ** 2)
    errors = [np.median(np.abs(each / true - 1)) for each in (found.G[:, 0, 0], fed_back)]
    assert errors[0] < 0.6 * errors[1]
    with pytest.warns(DataWarning, match="after 'lat' may be noise that is fed back"):
        biased = frequency_response([plain], omega=own.omega)
    assert np.isnan(biased.G[own.omega < 5]).all()
    with pytest.raises(ValueError, match=r"'r_lat' is not read; name it in channels\.check"):
        run_stages(Task(model=TRUTH, roles=roles, **given))
