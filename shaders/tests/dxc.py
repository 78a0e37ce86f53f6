"""Compiles HLSL with Microsoft's compiler, of which only the library is there:

    python3 dxc.py LIBRARY PROFILE ENTRY FILE...

LIBRARY is libdxcompiler.so. Prints what the compiler says of each file that it refuses, and ends with status 1 if there is one.
"""

import ctypes
import pathlib
import sys
import uuid

# Interfaces and their methods by place in the table, as dxcapi.h declares them. Off Windows, two destructors follow the
# three methods that every interface begins with.
COMPILER = "73e22d93-e6ce-47f3-b5bf-f0664f39c1b0"
COMPILER_INTERFACE = "228b4687-5a6a-4730-900c-9702b2203f54"
RESULT_INTERFACE = "58346cda-dde7-4497-9461-6f87af5e0659"
FIRST = 5
COMPILE = FIRST
STATUS, RESULT, ERRORS = FIRST, FIRST + 1, FIRST + 2
POINTER, SIZE = FIRST, FIRST + 1
UTF8 = 65001


class Source(ctypes.Structure):
    _fields_ = [("pointer", ctypes.c_void_p), ("size", ctypes.c_size_t), ("encoding", ctypes.c_uint32)]


def identifier(text):
    return (ctypes.c_char * 16).from_buffer_copy(uuid.UUID(text).bytes_le)


def method(thing, place, result, *types):
    table = ctypes.cast(thing, ctypes.POINTER(ctypes.POINTER(ctypes.c_void_p))).contents
    function = ctypes.CFUNCTYPE(result, ctypes.c_void_p, *types)(table[place])
    return lambda *arguments: function(thing, *arguments)


def address(thing):
    return ctypes.cast(ctypes.byref(thing), ctypes.c_void_p)


def check(status, of):
    if status != 0:
        sys.exit(f"{of} failed with {status & 0xFFFFFFFF:#x}")


def blob(result, place):
    """The bytes that a result holds."""
    thing = ctypes.c_void_p()
    check(method(result, place, ctypes.c_int32, ctypes.c_void_p)(address(thing)), "reading a result")
    if not thing:
        return b""
    return ctypes.string_at(method(thing, POINTER, ctypes.c_void_p)(), method(thing, SIZE, ctypes.c_size_t)())


def compile_file(compiler, path, profile, entry):
    """Whether the compiler takes the file, and what it says."""
    text = path.read_bytes()
    kept = ctypes.create_string_buffer(text, len(text))
    source = Source(ctypes.cast(kept, ctypes.c_void_p), len(text), UTF8)
    flags = ["-T", profile, "-E", entry, "-Wno-parentheses-equality"]
    flags = (ctypes.c_wchar_p * len(flags))(*flags)
    result = ctypes.c_void_p()
    types = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p]
    run = method(compiler, COMPILE, ctypes.c_int32, *types)
    wanted = identifier(RESULT_INTERFACE)
    check(
        run(address(source), ctypes.cast(flags, ctypes.c_void_p), len(flags), None, address(wanted), address(result)),
        "compiling",
    )
    status = ctypes.c_int32()
    check(method(result, STATUS, ctypes.c_int32, ctypes.c_void_p)(address(status)), "asking for the status")
    return status.value == 0 and len(blob(result, RESULT)) > 0, blob(result, ERRORS).decode(errors="replace")


def main():
    library, profile, entry, *files = sys.argv[1:]
    compiler = ctypes.c_void_p()
    create = ctypes.CDLL(library).DxcCreateInstance
    check(create(identifier(COMPILER), identifier(COMPILER_INTERFACE), ctypes.byref(compiler)), "making a compiler")
    refused = 0
    for file in files:
        is_taken, said = compile_file(compiler, pathlib.Path(file), profile, entry)
        if not is_taken:
            refused += 1
            print(f"{file}: {said}")
    sys.exit(1 if refused else 0)


main()
