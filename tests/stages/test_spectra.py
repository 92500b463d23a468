"""The stage of the measured frequency response."""

import numpy as np
from truths.closed_roll import TRUTH, noisy

from casid import SpectralAnalysis, frequency_response
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
