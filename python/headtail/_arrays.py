"""Converts arrays to contiguous rows of 32-bit floats, without a copy where possible."""

import numpy as np

from ._native import HeadtailError


def view(value, name):
    """Returns a numpy array from numpy arrays, DLPack arrays on the CPU, or lists."""
    if isinstance(value, np.ma.MaskedArray):
        if np.ma.is_masked(value):
            raise HeadtailError(f"{name}: is a masked array; say what its masked elements are, as in array.filled(0)")
        return value.data
    if isinstance(value, np.ndarray):
        return value
    if hasattr(value, "__dlpack__"):
        try:
            return np.from_dlpack(value)
        except (BufferError, RuntimeError, TypeError, ValueError) as error:
            raise HeadtailError(f"{name}: cannot be read as a CPU array ({error})") from error
    return np.asarray(value)


def floats(value, name):
    """Returns a contiguous array of 32-bit floats."""
    array = view(value, name)
    if array.dtype.kind not in "fiu":
        raise HeadtailError(f"{name}: holds {array.dtype}, not real numbers")
    return np.ascontiguousarray(array, dtype=np.float32)


def rows(value, name, width):
    """Returns an array [count, width]; a single row may omit its first dimension."""
    array = floats(value, name)
    if array.shape == (width,):
        array = array[None]
    if array.ndim != 2 or array.shape[1] != width:
        raise HeadtailError(f"{name}: has the shape {array.shape}, not [count, {width}]")
    return array


def numbers(value, name):
    """Returns an array [count], or one number for all rows."""
    array = floats(value, name)
    array = array[None] if array.ndim == 0 else array
    if array.ndim != 1:
        raise HeadtailError(f"{name}: has the shape {array.shape}, not [count]")
    return array


def result(out, name, shape):
    """Returns the array for a result: a new one, or `out`, which must match exactly."""
    if out is None:
        return np.empty(shape, np.float32)
    array = out if isinstance(out, np.ndarray) else _writable(out, name)
    if array.dtype != np.float32 or array.shape != shape or not array.flags.c_contiguous or not array.flags.writeable:
        raise HeadtailError(
            f"out: {name} must be a writable contiguous array of float32 with the shape {shape}, "
            f"not of {array.dtype} with the shape {array.shape}"
        )
    return array


def _writable(out, name):
    """Returns a writable view of another library's array. Old versions of DLPack cannot declare this; numpy's
    protocol can."""
    array = view(out, name)
    if not array.flags.writeable and hasattr(out, "__array__"):
        other = np.asarray(out)
        if np.shares_memory(array, other):
            return other
    return array
