"""Measured records against a model: where they disagree, the name of what is missing, and the model with it added."""

from bristle.diagnosis.export import write
from bristle.diagnosis.foreign import diagnose_fmu
from bristle.diagnosis.intake import load_records, records_from_arrays
from bristle.diagnosis.modelfile import Model, load_model
from bristle.diagnosis.plantfmu import fmu_model
from bristle.diagnosis.record import Record
from bristle.diagnosis.result import Diagnosis
from bristle.diagnosis.workflow import diagnose
from bristle.model.errors import BristleError

__all__ = [
    "BristleError", "Diagnosis", "Model", "Record", "diagnose", "diagnose_fmu", "fmu_model", "load_model", "load_records",
    "records_from_arrays", "write",
]  # fmt: skip
