"""Names of the report, read by type checkers and by casid/report/__init__.py."""

from . import drawings as drawings, envelopes as envelopes
from .content import (
    BASELINE as BASELINE,
    BLACK_BOX as BLACK_BOX,
    MATCH as MATCH,
    OUTPUT_ERROR as OUTPUT_ERROR,
    Caution as Caution,
    Content as Content,
    DataFile as DataFile,
    Drawing as Drawing,
    Section as Section,
    Timing as Timing,
)
from .figures import (
    plot_autocorrelation as plot_autocorrelation,
    plot_coherence as plot_coherence,
    plot_history as plot_history,
    plot_input as plot_input,
    plot_magnitude as plot_magnitude,
    plot_match_error as plot_match_error,
    plot_measured as plot_measured,
    plot_phase as plot_phase,
    plot_poles as plot_poles,
    plot_rms as plot_rms,
    plot_singular_values as plot_singular_values,
)
from .html import write_report as write_report
from .prices import plot_bounds as plot_bounds
from .readings import (
    plot_handling_qualities as plot_handling_qualities,
    plot_order_selection as plot_order_selection,
)
