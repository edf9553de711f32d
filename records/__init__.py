"""Measured records: read, converted to SI, brought to a uniform time, checked."""

from bristle.records.intake import Requirements, read_record, read_records, records_from_arrays
from bristle.records.layout import Column, Layout
from bristle.records.record import Record

__all__ = [
    "Column",
    "Layout",
    "Record",
    "Requirements",
    "read_record",
    "read_records",
    "records_from_arrays",
]
