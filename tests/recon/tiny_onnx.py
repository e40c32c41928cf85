"""Writes a minimal ONNX file by hand: inputs, constant outputs tied to the input by a zero, nothing else.

Wire format: protocol buffers (varints and length-delimited fields); field numbers from onnx.proto of ONNX
1.16.
"""

from pathlib import Path

import numpy as np


def write_constant_model(
    path: Path, outputs: dict[str, np.ndarray], *, input_shape: tuple[int | str, ...]
) -> None:
    """A model `images` -> outputs, each a constant plus 0 * mean(images)."""
    nodes = [
        _node("ReduceMean", ["images"], ["mean"], keepdims=0),
        _node("Mul", ["mean", "nought"], ["zero"]),
    ]
    nodes += [_node("Add", [f"{name}_is", "zero"], [name]) for name in outputs]
    constants = [_tensor("nought", np.zeros((), np.float32))]
    constants += [_tensor(f"{name}_is", value.astype(np.float32)) for name, value in outputs.items()]
    _write(path, nodes, constants, {name: value.shape for name, value in outputs.items()}, input_shape)


def write_external_model(path: Path, location: str) -> None:
    """A fruit model whose log odds are numbers in the file `location`, four bytes each."""
    shape = (1, 1, 2, 2)
    entry = _bytes(1, b"location") + _bytes(2, location.encode())
    numbers = (
        b"".join(_int(1, d) for d in shape) + _int(2, 1) + _bytes(8, b"far") + _bytes(13, entry) + _int(14, 1)
    )
    nodes = [
        _node("ReduceMean", ["images"], ["mean"], keepdims=0),
        _node("Add", ["far", "mean"], ["fruit_log_odds"]),
    ]
    _write(path, nodes, [numbers], {"fruit_log_odds": shape})


def write_large_model(path: Path, side: int) -> None:
    """A model of 1 kB that makes a matrix of side x side numbers."""
    sides = _int(1, 2) + _int(2, 7) + _bytes(8, b"sides") + _bytes(9, np.array([side, side]).tobytes())
    nodes = [
        _node("ReduceMean", ["images"], ["mean"], keepdims=0),
        _node("ConstantOfShape", ["sides"], ["large"]),
        _node("Add", ["large", "mean"], ["moved"]),
        _node("ReduceMean", ["moved"], ["fruit_log_odds"], keepdims=0),
    ]
    _write(path, nodes, [sides], {"fruit_log_odds": ()})


def _write(
    path: Path,
    nodes: list[bytes],
    numbers: list[bytes],
    outputs: dict[str, tuple[int, ...]],
    input_shape: tuple[int | str, ...] = ("n", 3, 192, 192),
) -> None:
    graph = b"".join(_bytes(1, n) for n in nodes) + _bytes(2, b"g") + b"".join(_bytes(5, n) for n in numbers)
    graph += _bytes(11, _value("images", input_shape))
    graph += b"".join(_bytes(12, _value(name, shape)) for name, shape in outputs.items())
    path.write_bytes(_int(1, 8) + _bytes(7, graph) + _bytes(8, _bytes(1, b"") + _int(2, 13)))


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def _int(field: int, value: int) -> bytes:
    return _varint(field << 3) + _varint(value)


def _bytes(field: int, data: bytes) -> bytes:
    return _varint(field << 3 | 2) + _varint(len(data)) + data


def _node(kind: str, inputs: list[str], outputs: list[str], **attributes: int) -> bytes:
    body = b"".join(_bytes(1, i.encode()) for i in inputs) + b"".join(_bytes(2, o.encode()) for o in outputs)
    body += _bytes(4, kind.encode())
    for name, value in attributes.items():
        body += _bytes(5, _bytes(1, name.encode()) + _int(3, value) + _int(20, 2))
    return body


def _tensor(name: str, value: np.ndarray) -> bytes:
    dims = b"".join(_int(1, d) for d in value.shape)
    return dims + _int(2, 1) + _bytes(8, name.encode()) + _bytes(9, value.tobytes())


def _value(name: str, shape: tuple[int | str, ...]) -> bytes:
    dims = b"".join(_bytes(1, _int(1, d) if isinstance(d, int) else _bytes(2, d.encode())) for d in shape)
    return _bytes(1, name.encode()) + _bytes(2, _bytes(1, _int(1, 1) + _bytes(2, dims)))
