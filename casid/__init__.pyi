"""Public names, read by type checkers and by casid/__init__.py."""

from .bands import (
    ModeBand as ModeBand,
    ResponseBand as ResponseBand,
    mode_bands as mode_bands,
    response_band as response_band,
)
from .bandwidth import HandlingBand as HandlingBand, handling_band as handling_band
from .baseline.accuracy import DerividNotes as DerividNotes
from .baseline.derivid import Derivid as Derivid, derivid as derivid
from .baseline.handling import (
    HandlingQualities as HandlingQualities,
    handling_qualities as handling_qualities,
)
from .baseline.loes import (
    TransferFunction as TransferFunction,
    transfer_function as transfer_function,
)
from .bounds.compare import BoundsComparison as BoundsComparison, compare_bounds as compare_bounds
from .bounds.manoeuvres import (
    StructureComparison as StructureComparison,
    compare_structures as compare_structures,
)
from .bounds.profiles import Profile as Profile, profile_parameters as profile_parameters
from .bounds.reduction import (
    Reduction as Reduction,
    ReductionRule as ReductionRule,
    reduce_structure as reduce_structure,
)
from .bounds.resampling import (
    Ensemble as Ensemble,
    bootstrap as bootstrap,
    monte_carlo as monte_carlo,
)
from .bounds.starts import Multistart as Multistart, multistart as multistart
from .chain import Identification as Identification, identify as identify
from .commands.inspection import Inspection as Inspection, inspect_records as inspect_records
from .consistency.kinematics import (
    KinematicCheck as KinematicCheck,
    kinematic_check as kinematic_check,
)
from .cover import Cover as Cover, cover as cover
from .design.inputs import design_inputs as design_inputs
from .design.specification import DesignSettings as DesignSettings, Limits as Limits
from .design.plan import Design as Design
from .display import ProgressLine as ProgressLine
from .distances import Distance as Distance, Distances as Distances, distances as distances
from .eigenmodes import Mode as Mode, modes as modes
from .undermodelling import Undermodelling as Undermodelling, structure_error as structure_error
from .envelope import Envelope as Envelope, envelope as envelope
from .errors import (
    ConvergenceError as ConvergenceError,
    DataWarning as DataWarning,
    ModelError as ModelError,
)
from .estimator import Estimator as Estimator
from .exchange.code import write_c as write_c, write_fmu as write_fmu
from .exchange.delays import without_delay as without_delay
from .exchange.equations import Equations as Equations, equations_of as equations_of
from .exchange.formats import (
    pairs_of as pairs_of,
    read_parquet as read_parquet,
    read_record as read_record,
    write_fit_mat as write_fit_mat,
    write_frequency as write_frequency,
    write_mat as write_mat,
    write_parquet as write_parquet,
)
from .exchange.objects import (
    from_control as from_control,
    from_dataframe as from_dataframe,
    from_scipy as from_scipy,
    to_control as to_control,
    to_dataframe as to_dataframe,
    to_scipy as to_scipy,
)
from .exchange.listing import write_equations as write_equations
from .exchange.standalone import write_module as write_module
from .excitations import Excitation as Excitation
from .excitations import excitation as excitation
from .files import read_csv as read_csv, read_mat as read_mat, write_csv as write_csv
from .fit import (
    Certificate as Certificate,
    ConstraintEstimate as ConstraintEstimate,
    Fit as Fit,
    ParameterEstimate as ParameterEstimate,
)
from .frequency.distortion import Distortion as Distortion
from .frequency.distortion import distortion as distortion
from .frequency.estimation import (
    SpectralAnalysis as SpectralAnalysis,
    frequency_response as frequency_response,
)
from .frequency.response import FrequencyResponse as FrequencyResponse
from .frequency.responses import (
    merge_responses as merge_responses,
    read_frequency_csv as read_frequency_csv,
)
from .jobs.campaigns import CampaignProgress as CampaignProgress, Execution as Execution
from .linear import StateSpace as StateSpace
from .logs.drafting import Draft as Draft, import_log as import_log
from .logs.reading import read_log as read_log
from .logs.topics import Log as Log, Topic as Topic
from .matching.appraisal import MatchNotes as MatchNotes
from .matching.match import Match as Match, match as match
from .missing_modes import MissingMode as MissingMode
from .model import (
    Constraint as Constraint,
    Model as Model,
    Rows as Rows,
    matrix as matrix,
    parameter as parameter,
)
from .nlp import Progress as Progress, SolverOptions as SolverOptions
from .nonlinear.conditions import Trim as Trim
from .nonlinear.model import NonlinearModel as NonlinearModel
from .nonlinear.tables import spline as spline
from .nonlinear.trims import find_trim as find_trim
from .outlier_detection import outliers as outliers
from .qualification import (
    Qualification as Qualification,
    qualify as qualify,
)
from .propagation import sample_models as sample_models
from .record import Record as Record
from .repeated_samples import repeated as repeated, without_repeats as without_repeats
from .report.plots import compare as compare
from .report.tables import summary as summary
from .residuals import Residuals as Residuals, residuals as residuals
from .sensors import Scalar as Scalar, Sensor as Sensor
from .shooting.nonlinear import Integration as Integration
from .shooting.clocks import InputDelay as InputDelay, input_delays as input_delays
from .shooting.output_error import OutputError as OutputError, output_error as output_error
from .shooting.precision import OutputErrorNotes as OutputErrorNotes
from .shooting.simulation import simulate as simulate
from .stages.chain import Chain as Chain
from .stages.choice import Choosing as Choosing, StepChoice as StepChoice
from .stages.listing import STAGES as STAGES
from .stages.matching import Matching as Matching
from .stages.stage import Stage as Stage, Task as Task
from .structure.identifiability import (
    Identifiability as Identifiability,
    identifiability as identifiability,
)
from .structure.modelfile import load_model as load_model
from .studies.runner import run_study as run_study
from .studies.study import read_records as read_records
from .studies.studyfile import read_study as read_study
from .subspace.pbsid import BlackBox as BlackBox, Pbsid as Pbsid, pbsid as pbsid
from .subspace.candidates import OrderSelection as OrderSelection
from .subspace.settings import select_order as select_order
from .validation import Validation as Validation, validate as validate
