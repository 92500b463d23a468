"""Figures and the report page; the only import of matplotlib and of the page's libraries."""

from casid.report.content import (
    BASELINE,
    BLACK_BOX,
    MATCH,
    OUTPUT_ERROR,
    Caution,
    Content,
    DataFile,
    Drawing,
    Section,
    Timing,
)
from casid.report.figures import (
    plot_autocorrelation,
    plot_coherence,
    plot_history,
    plot_input,
    plot_magnitude,
    plot_match_error,
    plot_measured,
    plot_phase,
    plot_poles,
    plot_rms,
    plot_singular_values,
)
from casid.report.html import write_report
from casid.report.prices import plot_bounds
from casid.report.readings import plot_handling_qualities
from casid.report.selection import plot_order_selection

__all__ = ["BASELINE", "BLACK_BOX", "MATCH", "OUTPUT_ERROR", "Caution", "Content"]
__all__ += ["DataFile", "Drawing", "Section", "Timing"]
__all__ += ["plot_autocorrelation", "plot_bounds", "plot_coherence", "plot_handling_qualities"]
__all__ += ["plot_history", "plot_input", "plot_magnitude", "plot_match_error", "plot_measured"]
__all__ += ["plot_order_selection", "plot_phase", "plot_poles", "plot_rms", "plot_singular_values"]
__all__ += ["write_report"]
