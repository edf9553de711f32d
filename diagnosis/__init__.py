"""Measured records against a model: where they disagree, what is missing, the model with it."""

from bristle.common.errors import BristleError
from bristle.diagnosis.answer import Diagnosis, Validation
from bristle.diagnosis.checks.records import load_records, records_from_arrays
from bristle.diagnosis.fmu.model import fmu_model
from bristle.diagnosis.modelfile import Model, load_model
from bristle.diagnosis.report.export import write
from bristle.diagnosis.report.validation_page import write_validation
from bristle.diagnosis.report.writer import ReportWriter
from bristle.diagnosis.selection.start_values import SearchOptions
from bristle.diagnosis.slow.stick_slip import StickSlip, stick_slip
from bristle.diagnosis.workflow import diagnose, diagnose_fmu, validate, validate_fmu
from bristle.records.record import Record

Diagnosis.writer = Validation.writer = ReportWriter()

__all__ = [
    "BristleError",
    "Diagnosis",
    "Model",
    "Record",
    "SearchOptions",
    "StickSlip",
    "Validation",
    "diagnose",
    "diagnose_fmu",
    "fmu_model",
    "load_model",
    "load_records",
    "records_from_arrays",
    "stick_slip",
    "validate",
    "validate_fmu",
    "write",
    "write_validation",
]
