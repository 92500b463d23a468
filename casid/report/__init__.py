"""Figures and the report page; the only import of matplotlib and of the page's libraries.

Names stand in ``__init__.pyi``; each is imported when it is first used: a study whose results are
all kept draws nothing.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
