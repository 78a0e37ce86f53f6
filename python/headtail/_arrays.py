"""Arrays as the compiled part takes them: contiguous, of 32-bit floats, in rows; without a copy where they are that already."""

import numpy as np

from ._native import HeadtailError


def view(value, name):
    """A numpy array of anything that is one: numpy's, DLPack's on the CPU, lists."""
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
    """A contiguous array of 32-bit floats."""
    array = view(value, name)
    if array.dtype.kind not in "fiu":
        raise HeadtailError(f"{name}: holds {array.dtype}, not real numbers")
    return np.ascontiguousarray(array, dtype=np.float32)


def rows(value, name, width):
    """An array [count, width]; a single row may leave its first dimension out."""
    array = floats(value, name)
    if array.shape == (width,):
        array = array[None]
    if array.ndim != 2 or array.shape[1] != width:
        raise HeadtailError(f"{name}: has the shape {array.shape}, not [count, {width}]")
    return array


def numbers(value, name):
    """An array [count] of one number for each row, or for all."""
    array = floats(value, name)
    array = array[None] if array.ndim == 0 else array
    if array.ndim != 1:
        raise HeadtailError(f"{name}: has the shape {array.shape}, not [count]")
    return array


def result(out, name, shape):
    """The array that a result is written to: a new one, or `out`, which must fit as it is."""
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
    """A view of another library's array. Old forms of DLPack cannot say that they may be written to; numpy's own protocol can."""
    array = view(out, name)
    if not array.flags.writeable and hasattr(out, "__array__"):
        other = np.asarray(out)
        if np.shares_memory(array, other):
            return other
    return array
