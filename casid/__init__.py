"""Rotorcraft system identification in the time and frequency domains."""

from casid.bounds import BoundsComparison, compare_bounds
from casid.chain import Identification, identify
from casid.derivid import derivid
from casid.errors import ConvergenceError, DataWarning, ModelError
from casid.files import read_csv, read_mat, write_csv
from casid.fit import Certificate, Fit, ParameterEstimate
from casid.formats import read_parquet, read_record, write_mat, write_parquet
from casid.frequency import FrequencyResponse, frequency_response
from casid.handling import HandlingQualities, handling_qualities
from casid.identifiability import Identifiability, identifiability
from casid.inspection import Inspection, inspect
from casid.kinematics import KinematicCheck, kinematic_check
from casid.linear import StateSpace
from casid.loes import TransferFunction, transfer_function
from casid.matching import match
from casid.model import Constraint, Model, Rows, Scalar, matrix, parameter
from casid.nlp import Progress, SolverOptions
from casid.pbsid import BlackBox, pbsid
from casid.profile import Profile, profile
from casid.record import Record
from casid.reduction import Reduction, reduce_structure
from casid.resampling import Ensemble, Multistart, bootstrap, monte_carlo, multistart
from casid.responses import merge_responses, read_frequency_csv
from casid.settings import OrderSelection, select_order
from casid.shooting import output_error
from casid.validation import Validation, validate

__all__ = [
    "BlackBox",
    "BoundsComparison",
    "Certificate",
    "Constraint",
    "ConvergenceError",
    "DataWarning",
    "Ensemble",
    "Fit",
    "FrequencyResponse",
    "HandlingQualities",
    "Identifiability",
    "Identification",
    "Inspection",
    "KinematicCheck",
    "Model",
    "ModelError",
    "Multistart",
    "OrderSelection",
    "ParameterEstimate",
    "Profile",
    "Progress",
    "Record",
    "Reduction",
    "Rows",
    "Scalar",
    "SolverOptions",
    "StateSpace",
    "TransferFunction",
    "Validation",
    "bootstrap",
    "compare_bounds",
    "derivid",
    "frequency_response",
    "handling_qualities",
    "identifiability",
    "identify",
    "inspect",
    "kinematic_check",
    "match",
    "matrix",
    "merge_responses",
    "monte_carlo",
    "multistart",
    "output_error",
    "parameter",
    "pbsid",
    "profile",
    "read_csv",
    "read_frequency_csv",
    "read_mat",
    "read_parquet",
    "read_record",
    "reduce_structure",
    "select_order",
    "transfer_function",
    "validate",
    "write_csv",
    "write_mat",
    "write_parquet",
]
