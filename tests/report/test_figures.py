"""The matching error against its certificate, drawn and on the page."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from truths.structures import SECOND, Lag, black_box

from casid import Fit, match
from casid.report import plot_match_error


def test_singular_values_lie_under_the_bound_and_touch_the_grid_norm(tmp_path):
    match(Lag(), black_box(SECOND)).save(tmp_path / "fit.json")
    fit = Fit.load(tmp_path / "fit.json", model=Lag)  # as a study kept it
    ax = plot_match_error(Figure().subplots(), fit)
    lines = {line.get_label(): line for line in ax.get_lines()}
    sigma = lines["black box"].get_ydata()
    error = fit.model.system().response(lines["black box"].get_xdata()) - SECOND.response(
        lines["black box"].get_xdata()
    )
    np.testing.assert_allclose(sigma, np.abs(error[:, 0, 0]), rtol=1e-12)
    bound = lines["bound"].get_ydata()[0]
    assert bound == fit.certificate.upper_bound
    assert sigma.max() <= bound
    assert sigma.max() == pytest.approx(fit.certificate.grid_norm, rel=0.01)
    assert lines["x from u"].get_xdata()[0] == fit.certificate.peak_omega


def test_a_fit_without_certificate_is_refused():
    fit = match(Lag(), black_box(SECOND))
    bare = Fit(**{name: getattr(fit, name) for name in vars(fit)} | {"certificate": None})
    with pytest.raises(ValueError, match="has no certificate"):
        plot_match_error(Figure().subplots(), bare)
