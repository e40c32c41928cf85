"""The cached result of a stage: a frozen record, validated when it is made and when it is read."""

import json
from collections.abc import Mapping
from typing import Any, Self

import numpy as np
from jaxtyping import jaxtyped
from pydantic import BaseModel, ConfigDict, ModelWrapValidatorHandler, model_validator

ARRAY = "__array__"
"""Key that replaces an array in a record's JSON: {ARRAY: its name among the file's arrays}."""


class StageRecord(BaseModel):
    """A stage's result: numbers, text, arrays, further stage records.

    An array is annotated with its type and shape (jaxtyping); a dimension's name means one length within a
    record. Raises pydantic.ValidationError if a field is missing, unknown, or has another type or shape.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)

    @model_validator(mode="wrap")
    @classmethod
    def _of_one_shape(cls, value: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        with jaxtyped("context"):  # compares dimensions of one name within this record
            return handler(value)

    def stored(self) -> tuple[str, dict[str, np.ndarray]]:
        """The record as JSON text and named arrays: what `restored` reads."""
        arrays: dict[str, np.ndarray] = {}
        return json.dumps(_without_arrays(self.model_dump(), "", arrays)), arrays

    @classmethod
    def restored(cls, text: str, arrays: Mapping[str, np.ndarray]) -> Self:
        """The record from the output of `stored`; raises ValueError or ValidationError if it is invalid."""
        try:
            return cls.model_validate(_with_arrays(json.loads(text), arrays))
        except KeyError as missing:
            raise ValueError(f"array {missing} is missing.") from missing


def _without_arrays(value: Any, name: str, arrays: dict[str, np.ndarray]) -> Any:
    """The value with every array moved into `arrays`, named by its path in the record."""
    if isinstance(value, np.ndarray):
        arrays[name] = value
        return {ARRAY: name}
    if isinstance(value, dict):
        under = f"{name}." if name else ""
        return {key: _without_arrays(inner, f"{under}{key}", arrays) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_without_arrays(inner, f"{name}.{k}", arrays) for k, inner in enumerate(value)]
    return value


def _with_arrays(value: Any, arrays: Mapping[str, np.ndarray]) -> Any:
    if isinstance(value, dict):
        if value.keys() == {ARRAY}:
            return arrays[value[ARRAY]]
        return {key: _with_arrays(inner, arrays) for key, inner in value.items()}
    if isinstance(value, list):
        return [_with_arrays(inner, arrays) for inner in value]
    return value
