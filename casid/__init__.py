"""Rotorcraft system identification in the time and frequency domains."""

from casid.baseline.accuracy import DerividNotes
from casid.baseline.derivid import Derivid, derivid
from casid.baseline.handling import HandlingQualities, handling_qualities
from casid.baseline.loes import TransferFunction, transfer_function
from casid.bounds.compare import BoundsComparison, compare_bounds
from casid.bounds.profile import Profile, profile
from casid.bounds.reduction import Reduction, reduce_structure
from casid.bounds.resampling import Ensemble, Multistart, bootstrap, monte_carlo, multistart
from casid.chain import Chain, Identification, identify
from casid.commands.inspection import Inspection, inspect_records
from casid.consistency.kinematics import KinematicCheck, kinematic_check
from casid.eigenmodes import Mode, modes
from casid.errors import ConvergenceError, DataWarning, ModelError
from casid.estimator import Estimator
from casid.exchange.formats import (
    pairs_of,
    read_parquet,
    read_record,
    write_fit_mat,
    write_frequency,
    write_mat,
    write_parquet,
)
from casid.exchange.objects import (
    from_control,
    from_dataframe,
    from_scipy,
    to_control,
    to_dataframe,
    to_scipy,
    without_delay,
)
from casid.exchange.standalone import write_module
from casid.files import read_csv, read_mat, write_csv
from casid.fit import Certificate, ConstraintEstimate, Fit, ParameterEstimate
from casid.frequency.estimation import FrequencyResponse, SpectralAnalysis, frequency_response
from casid.frequency.responses import merge_responses, read_frequency_csv
from casid.linear import StateSpace
from casid.matching.appraisal import MatchNotes
from casid.matching.match import Match, match
from casid.model import Constraint, Model, Rows, Scalar, matrix, parameter
from casid.nlp import Progress, SolverOptions
from casid.record import Record
from casid.shooting.output_error import OutputError, output_error
from casid.shooting.precision import OutputErrorNotes
from casid.structure.identifiability import Identifiability, identifiability
from casid.structure.modelfile import load_model
from casid.studies.study import read_records
from casid.studies.studyfile import read_study
from casid.subspace.pbsid import BlackBox, pbsid
from casid.subspace.settings import OrderSelection, select_order
from casid.validation import Validation, validate

__all__ = [
    "BlackBox",
    "BoundsComparison",
    "Certificate",
    "Chain",
    "Constraint",
    "ConstraintEstimate",
    "ConvergenceError",
    "DataWarning",
    "Derivid",
    "DerividNotes",
    "Ensemble",
    "Estimator",
    "Fit",
    "FrequencyResponse",
    "HandlingQualities",
    "Identifiability",
    "Identification",
    "Inspection",
    "KinematicCheck",
    "Match",
    "MatchNotes",
    "Mode",
    "Model",
    "ModelError",
    "Multistart",
    "OrderSelection",
    "OutputError",
    "OutputErrorNotes",
    "ParameterEstimate",
    "Profile",
    "Progress",
    "Record",
    "Reduction",
    "Rows",
    "Scalar",
    "SolverOptions",
    "SpectralAnalysis",
    "StateSpace",
    "TransferFunction",
    "Validation",
    "bootstrap",
    "compare_bounds",
    "derivid",
    "frequency_response",
    "from_control",
    "from_dataframe",
    "from_scipy",
    "handling_qualities",
    "identifiability",
    "identify",
    "inspect_records",
    "kinematic_check",
    "load_model",
    "match",
    "matrix",
    "merge_responses",
    "modes",
    "monte_carlo",
    "multistart",
    "output_error",
    "pairs_of",
    "parameter",
    "pbsid",
    "profile",
    "read_csv",
    "read_frequency_csv",
    "read_mat",
    "read_parquet",
    "read_record",
    "read_records",
    "read_study",
    "reduce_structure",
    "select_order",
    "to_control",
    "to_dataframe",
    "to_scipy",
    "transfer_function",
    "validate",
    "without_delay",
    "write_csv",
    "write_fit_mat",
    "write_frequency",
    "write_mat",
    "write_module",
    "write_parquet",
]
