"""What output error of a bank angle says of records that contradict each other."""

import warnings

from casid import DataWarning, output_error
from casid.shooting.homogeneity import OPPOSED
from truths.structures import Banking


def told(records, **settings):
    """The fit and what is said of records that contradict each other."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataWarning)
        fit = output_error(Banking(), records, **settings)
    return fit, [str(each.message) for each in caught if str(each.message).startswith(OPPOSED)]
