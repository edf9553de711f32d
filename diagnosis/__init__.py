"""Measured records against a model: where they disagree, the name of what is missing, and the model
with it added.
"""

from bristle.common.errors import BristleError
from bristle.diagnosis.checks.records import load_records, records_from_arrays
from bristle.diagnosis.fmu.model import fmu_model
from bristle.diagnosis.fmu.workflow import diagnose_fmu
from bristle.diagnosis.modelfile import Model, load_model
from bristle.diagnosis.report.export import write
from bristle.diagnosis.report.result import Diagnosis
from bristle.diagnosis.selection.start_values import SearchOptions
from bristle.diagnosis.whole.report import write_validation
from bristle.diagnosis.whole.validation import Validation, validate, validate_fmu
from bristle.diagnosis.workflow import diagnose
from bristle.records.record import Record

__all__ = [
    "BristleError",
    "Diagnosis",
    "Model",
    "Record",
    "SearchOptions",
    "Validation",
    "diagnose",
    "diagnose_fmu",
    "fmu_model",
    "load_model",
    "load_records",
    "records_from_arrays",
    "validate",
    "validate_fmu",
    "write",
    "write_validation",
]
