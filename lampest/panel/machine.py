"""Machine code from Python functions, and calls of functions of which only the address is known.

The one door of numba, which takes half a second to import: nobody imports this module before there is a frame to solve.
With NUMBA_DISABLE_JIT=1 in the environment the same functions run as plain Python and numpy, slowly.
"""

import ctypes
import hashlib
import inspect
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
from llvmlite import ir
from numba.extending import intrinsic, overload
from scipy.linalg import cython_blas, cython_lapack

from lampest.files.interrupts import interrupted


def machine_code(function: Callable[..., Any]) -> Any:
    """The function compiled for the types of its arguments, once: later processes read it from numba's cache.

    Where neither the package's folder nor the user's can be written, every process compiles it anew.
    """
    try:
        compiled = numba.njit(cache=True, error_model="numpy")(function)
    except RuntimeError:
        return numba.njit(error_model="numpy")(function)
    if hasattr(compiled, "_cache"):  # with NUMBA_DISABLE_JIT it is the function itself
        compiled._cache._cache_file._source_stamp = sources(Path(inspect.getfile(function)).parent)
    return compiled


@cache
def sources(folder: Path) -> tuple[tuple[str, str], ...]:
    """(name, digest) of all modules beside one another, and of this one.

    numba asks whether the file of the function that is called has changed, but that holds code of what it calls, too.
    """
    files = (*sorted(folder.glob("*.py")), Path(__file__))
    return tuple((file.name, hashlib.sha256(file.read_bytes()).hexdigest()) for file in files)


def result_of(function: Callable[..., Any], *arguments: Any) -> Any:
    """What machine code makes of its arguments; Ctrl-C meanwhile is no SystemError, which numba makes of it."""
    try:
        return function(*arguments)
    except SystemError as error:
        if interrupted(error):
            raise KeyboardInterrupt from error
        raise


def call(address: int, pointers: tuple[int, ...]) -> None:
    """Call a C function that returns nothing and takes pointers alone."""
    prototype = ctypes.PYFUNCTYPE(None, *(ctypes.c_void_p for _ in pointers))
    prototype(int(address))(*(int(pointer) for pointer in pointers))


@intrinsic
def _called(typing: Any, address: Any, pointers: Any) -> Any:
    """The same in machine code: an address as a number is no constant of the code, which may so be kept on disk."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        byte = ir.IntType(8).as_pointer()
        count = len(signature.args[1])
        function = ir.FunctionType(ir.VoidType(), [byte] * count).as_pointer()
        values = [builder.extract_value(arguments[1], number) for number in range(count)]
        builder.call(builder.inttoptr(arguments[0], function), [builder.inttoptr(value, byte) for value in values])
        return context.get_dummy_value()

    return numba.types.void(address, pointers), generate


@overload(call, strict=False)  # annotations alone make two signatures differ
def _call_in_machine_code(address: Any, pointers: Any) -> Any:
    return lambda address, pointers: _called(address, pointers)  # type: ignore[call-arg]


def clock_address() -> int:
    """Of `clock_gettime`, of which the first argument is a number and no pointer; 0 where there is none."""
    function = getattr(ctypes.CDLL(None), "clock_gettime", None) if os.name == "posix" else None
    return 0 if function is None else int(ctypes.cast(function, ctypes.c_void_p).value or 0)


def blas_address(name: str) -> int:
    """Of a Fortran subroutine of BLAS or LAPACK as scipy brings it."""
    library = cython_blas if name in cython_blas.__pyx_capi__ else cython_lapack
    return capsule_address(library.__pyx_capi__[name])


def capsule_address(capsule: Any) -> int:
    """What a PyCapsule points to."""
    interface = ctypes.pythonapi
    interface.PyCapsule_GetName.restype, interface.PyCapsule_GetName.argtypes = ctypes.c_char_p, [ctypes.py_object]
    interface.PyCapsule_GetPointer.restype = ctypes.c_void_p
    interface.PyCapsule_GetPointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
    return int(interface.PyCapsule_GetPointer(capsule, interface.PyCapsule_GetName(capsule)))
