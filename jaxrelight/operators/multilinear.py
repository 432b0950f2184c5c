"""Maps that are linear in each of several arguments, with adjoints that are written out: one primitive of JAX.

JAX differentiates a gather into a scatter, which takes several times as long, though a product with the transposed
matrix is as quick as one with the matrix. `custom_vjp` would forbid forward mode, and `linear_call` has no batching.
So products are a primitive of their own. Take F(a₁, …, aₙ), a number that is linear in each argument by itself, as
⟨y, T x⟩ is in T, x and y: its partial gradients ∂F/∂aᵢ are the product (by y), its transpose (by x) and the outer
product (by T). Each of them is again linear in all arguments that are left, and the transpose of ∂F/∂aᵢ as a function
of aⱼ is ∂F/∂aⱼ as one of aᵢ. So this family is closed under forward mode, reverse mode, and both of any order.
"""

import abc
import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import PyTree


class Multilinear(abc.ABC):
    """A form F(a₁, …, aₙ), linear in each argument. The last one, y, is what `product` gives: F = ⟨y, product⟩.

    A form is compared and hashed by its class and what it is made of: make it a frozen dataclass. Arguments are pytrees
    of floating-point arrays; what is held fixed, such as indices, is one pytree beside them.
    """

    @abc.abstractmethod
    def product(self, fixed: PyTree, *arguments: PyTree) -> PyTree:
        """∂F/∂y, of all arguments but y."""

    def adjoint(self, number: int, fixed: PyTree, arguments: Sequence[PyTree], like: PyTree) -> PyTree:
        """∂F/∂a of one argument, of all the others; a form that knows a quicker way than JAX's replaces this.

        Args:
            number: of the argument.
            fixed: what is held fixed.
            arguments: all of them, y too; that of the number is not used.
            like: shapes and types of the argument.
        """
        *given, y = arguments

        def of_argument(x):
            return self.product(fixed, *given[:number], x, *given[number + 1 :])

        return jax.linear_transpose(of_argument, like)(y)[0]

    def product_many(self, number: int, fixed: PyTree, *arguments: PyTree) -> PyTree | None:
        """`product` where one argument alone has a leading axis of many, as the result has; None for one by one."""
        return None

    def __call__(self, fixed: PyTree, *arguments: PyTree) -> PyTree:
        """The product, differentiable in all arguments, in both modes and to any order."""
        like = jax.eval_shape(self.product, fixed, *arguments)
        return self.partial(len(arguments), fixed, (*arguments, None), like)

    def partial(self, number: int, fixed: PyTree, arguments: Sequence[PyTree], like: PyTree) -> PyTree:
        """∂F/∂a of one argument, differentiable in all the others as the product is.

        Args:
            number: of the argument, of 0 … n − 1.
            fixed: what is held fixed.
            arguments: all of them, y too; None in the place of that one.
            like: shapes and types of that one.
        """
        return _partial(self, number, fixed, arguments, like)


def _partial(form: Multilinear, of: int, fixed: PyTree, arguments: Sequence[PyTree], like: PyTree) -> PyTree:
    structs, result = jax.tree.flatten(like)
    fixed_leaves, fixed_tree = jax.tree.flatten(fixed)
    leaves = [jax.tree.flatten(argument) for argument in arguments]
    flat = [leaf for some, _ in leaves for leaf in some]
    out = _PRIMITIVE.bind(
        *fixed_leaves,
        *flat,
        form=form,
        of=of,
        trees=(fixed_tree, *(tree for _, tree in leaves)),
        result=result,
        avals=tuple((tuple(one.shape), jnp.dtype(one.dtype)) for one in structs),
    )
    return jax.tree.unflatten(result, out)


def _grouped(flat: Sequence[Any], trees: Sequence[Any]) -> list[list[Any]]:
    """Leaves by pytree: of what is fixed, and of every argument."""
    groups, start = [], 0
    for tree in trees:
        groups.append(list(flat[start : start + tree.num_leaves]))
        start += tree.num_leaves
    return groups


def _unflattened(flat: Sequence[Any], trees: Sequence[Any]) -> list[PyTree]:
    return [jax.tree.unflatten(tree, some) for tree, some in zip(trees, _grouped(flat, trees), strict=True)]


def _computed(*flat, form, of, trees, result, avals):
    fixed, *arguments = _unflattened(flat, trees)
    like = jax.tree.unflatten(result, [jax.ShapeDtypeStruct(*aval) for aval in avals])
    is_product = of == len(arguments) - 1
    out = form.product(fixed, *arguments[:-1]) if is_product else form.adjoint(of, fixed, arguments, like)
    leaves = jax.tree.leaves(out)
    return [leaf.astype(dtype).reshape(shape) for leaf, (shape, dtype) in zip(leaves, avals, strict=True)]


def _differentiated(primals, tangents, **of_form):
    """Forward mode: a sum over the arguments that vary, of the map itself with each tangent in its argument's place."""
    trees = of_form["trees"]
    out = _PRIMITIVE.bind(*primals, **of_form)
    sums: list[Any] = [ad.Zero(jax.typeof(one).to_tangent_aval()) for one in out]
    values, rates = _grouped(primals, trees), _grouped(tangents, trees)
    for number in range(1, len(trees)):
        if all(isinstance(rate, ad.Zero) for rate in rates[number]):
            continue
        moved = [ad.instantiate_zeros(rate) for rate in rates[number]]
        flat = [leaf for i, some in enumerate(values) for leaf in (moved if i == number else some)]
        parts = _PRIMITIVE.bind(*flat, **of_form)
        sums = [
            part if isinstance(total, ad.Zero) else ad.add_jaxvals(total, part)
            for total, part in zip(sums, parts, strict=True)
        ]
    return out, sums


def _transposed(cotangents, *flat, form, of, trees, result, avals):
    """Reverse mode: the gradient by the argument that is sought, with the cotangent in the place of the result's."""
    groups = _grouped(flat, trees)
    sought = next(n for n, some in enumerate(groups) if any(ad.is_undefined_primal(leaf) for leaf in some))
    tree = trees[sought]
    like = jax.tree.unflatten(tree, [jax.ShapeDtypeStruct(leaf.aval.shape, leaf.aval.dtype) for leaf in groups[sought]])
    if all(isinstance(cotangent, ad.Zero) for cotangent in cotangents):
        return [ad.Zero(leaf.aval) if ad.is_undefined_primal(leaf) else None for leaf in flat]
    given = [None if n == sought else some for n, some in enumerate(groups)]
    given[of + 1] = [ad.instantiate_zeros(cotangent) for cotangent in cotangents]
    all_trees = [*trees]
    all_trees[of + 1] = result
    fixed, *arguments = (
        None if some is None else jax.tree.unflatten(tree, some) for tree, some in zip(all_trees, given, strict=True)
    )
    out = jax.tree.leaves(form.partial(sought - 1, fixed, arguments, like))
    return [leaf for n, some in enumerate(groups) for leaf in (out if n == sought else [None] * len(some))]


def _batched(flat, dims, *, form, of, trees, result, avals):
    """Many at once where the form has a way for that; else one after the other."""
    size = next(leaf.shape[dim] for leaf, dim in zip(flat, dims, strict=True) if dim is not None)
    flat = [leaf if dim is None else jnp.moveaxis(leaf, dim, 0) for leaf, dim in zip(flat, dims, strict=True)]
    is_many = [dim is not None for dim in dims]
    by_argument = [n for n, some in enumerate(_grouped(is_many, trees)) if any(some)]
    many = None
    if of == len(trees) - 2 and len(by_argument) == 1 and by_argument[0] > 0:
        number = by_argument[0]
        if all(_grouped(is_many, trees)[number]):
            fixed, *arguments = _unflattened(flat, trees)
            many = form.product_many(number - 1, fixed, *arguments[:-1])
    if many is not None:
        out = jax.tree.leaves(many)
        return [one.astype(dtype) for one, (_, dtype) in zip(out, avals, strict=True)], [0] * len(out)

    def one_of(number):
        each = [leaf[number] if many else leaf for leaf, many in zip(flat, is_many, strict=True)]
        return _PRIMITIVE.bind(*each, form=form, of=of, trees=trees, result=result, avals=avals)

    out = jax.lax.map(one_of, jnp.arange(size))
    return out, [0] * len(out)


@functools.partial(jax.jit, static_argnames=("form", "of", "trees", "result", "avals"))
def _compiled(*flat, form, of, trees, result, avals):
    return _computed(*flat, form=form, of=of, trees=trees, result=result, avals=avals)


def _made() -> Primitive:
    primitive = Primitive("multilinear")
    primitive.multiple_results = True
    primitive.def_impl(_compiled)
    primitive.def_abstract_eval(lambda *_, avals, **__: [ShapedArray(*aval) for aval in avals])
    mlir.register_lowering(primitive, mlir.lower_fun(_computed, multiple_results=True))
    ad.primitive_jvps[primitive] = _differentiated
    ad.primitive_transposes[primitive] = _transposed
    batching.primitive_batchers[primitive] = _batched
    return primitive


_PRIMITIVE = _made()
