"""Kernels that borrow the arrays that they are given: no references are counted in them.

numba counts references to an array that enters or leaves a kernel, or is taken out of a named tuple, with an atomic
instruction each, and can seldom prove that it need not. In kernels that are called millions of times with tuples of ten
arrays that is two thirds of the time. Here the arguments lose their owner where a kernel begins, which leaves nothing
to count. That is sound as long as whoever calls keeps them alive, as Python and numba do, and the kernel hands out no
part of them: it returns numbers alone, and is given nothing that could keep an array, such as a list. Both are checked
when it is compiled.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TypeVar

from llvmlite.ir import Constant
from numba.core import errors, ir, types
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import AnalysisPass, FunctionPass, register_pass
from numba.core.typed_passes import NopythonTypeInference
from numba.core.untyped_passes import IRProcessing
from numba.extending import intrinsic

from vascval.core.jit import njit

F = TypeVar("F")
_NUMBERS = (types.Number, types.Boolean, types.NoneType)
_LENT = (*_NUMBERS, types.Omitted, types.Array, types.Record, types.NumPyRandomGeneratorType)


def borrowing(function: F) -> F:
    """:func:`vascval.core.jit.njit` of a kernel that returns numbers, or tuples of them, and takes these, arrays and
    their records, random generators, and tuples of all that.

    :raises numba.core.errors.TypingError: when it is compiled for anything else.
    """
    return njit(function, pipeline_class=_Borrowing)  # type: ignore[no-any-return]


def _without_owner(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value=value)
        array.meminfo = Constant(array.meminfo.type, None)
        return array._getvalue()
    if _is_tuple(kind):
        for k, each in enumerate(kind):
            part = _without_owner(context, builder, each, builder.extract_value(value, k))
            value = builder.insert_value(value, part, k)
        return value
    context.nrt.incref(builder, kind, value)
    return value


@intrinsic
def borrowed(typingctx: Any, value: Any) -> Any:
    """What is given, its arrays without owner."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _without_owner(context, builder, signature.args[0], arguments[0])

    return value(value), generate


@register_pass(mutates_CFG=False, analysis_only=False)
class _BorrowArguments(FunctionPass):
    """``x = borrowed(x)`` for every argument, first of all."""

    _name = "vascval_borrow_arguments"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        first = state.func_ir.blocks[min(state.func_ir.blocks)]
        body = list[Any]()
        for one in first.body:
            body.append(one)
            if isinstance(one, ir.Assign) and isinstance(one.value, ir.Arg):
                x: Any = one.target
                loc = one.loc
                function = x.scope.redefine("$borrowed", loc)
                body.append(ir.Assign(ir.Global("borrowed", borrowed, loc), function, loc))
                body.append(ir.Assign(ir.Expr.call(function, (x,), (), loc), x, loc))
        first.body = body
        return True


@register_pass(mutates_CFG=False, analysis_only=True)
class _HandOutNothing(AnalysisPass):
    _name = "vascval_hand_out_nothing"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        for verb, kinds, allowed in (("takes", state.args, _LENT), ("returns", (state.return_type,), _NUMBERS)):
            for kind in _parts(kinds):
                if not isinstance(kind, allowed):
                    name = state.func_id.func_qualname
                    raise errors.TypingError(
                        f"kernel {name} {verb} {kind}, which may outlive the arrays that it borrows: use @njit"
                    )
        return False


def _is_tuple(kind: Any) -> bool:
    return isinstance(kind, types.BaseTuple)


def _parts(kinds: Any) -> Iterator[Any]:
    """What tuples within tuples are made of."""
    for kind in kinds:
        yield from _parts(kind) if _is_tuple(kind) else (kind,)


class _Borrowing(CompilerBase):
    """numba's compiler with these two passes."""

    def define_pipelines(self) -> list[Any]:
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_BorrowArguments, IRProcessing)
        passes.add_pass_after(_HandOutNothing, NopythonTypeInference)
        passes.finalize()
        return [passes]
