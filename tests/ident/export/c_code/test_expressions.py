"""Expressions compute what plain arithmetic does, with common parts stored once."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st

from ident.export.c_code.expressions import Expression, Graph, cosine, hyperbolic_tangent, sign, sine

NUMBERS = st.sampled_from([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 3.0])
LEAVES = st.one_of(st.sampled_from(["x", "y", "z"]), NUMBERS)
TREES = st.recursive(
    LEAVES,
    lambda inner: st.one_of(
        st.tuples(st.sampled_from(["+", "-", "*"]), inner, inner),
        st.tuples(st.sampled_from(["neg", "sin", "cos", "sign", "tanh"]), inner),
    ),
    max_leaves=25,
)
VALUES = {name: np.random.default_rng(seed).uniform(-1.5, 1.5, 5) for seed, name in enumerate("xyz")}
ONE = {"sin": (sine, np.sin), "cos": (cosine, np.cos), "sign": (sign, np.sign), "tanh": (hyperbolic_tangent, np.tanh)}


def both(graph: Graph, tree: object) -> tuple[Expression, np.ndarray]:
    """A tree as an expression and as numbers."""
    if isinstance(tree, str):
        return graph.symbol(tree), VALUES[tree]
    if isinstance(tree, float):
        return graph.constant(tree), np.full(5, tree)
    operation, *operands = tree
    parts = [both(graph, operand) for operand in operands]
    if operation == "neg":
        return -parts[0][0], -parts[0][1]
    if operation in ONE:
        symbolic, numeric = ONE[operation]
        return symbolic(parts[0][0]), numeric(parts[0][1])
    (a, x), (b, y) = parts
    if operation == "+":
        return a + b, x + y
    return (a - b, x - y) if operation == "-" else (a * b, x * y)


def steady(tree: object) -> bool:
    """Whether no sign is taken of a sum, which rounding may leave a little beside zero."""
    return not isinstance(tree, tuple) or (
        (tree[0] != "sign" or isinstance(tree[1], str)) and all(map(steady, tree[1:]))
    )


@given(TREES.filter(steady))
def test_value_is_that_of_plain_arithmetic(tree):
    graph = Graph()
    expression, expected = both(graph, tree)
    np.testing.assert_allclose(
        graph.evaluate([expression], VALUES)[0], expected, rtol=1e-12, atol=1e-12 * (1 + np.abs(expected).max())
    )


@given(TREES, TREES)
def test_sums_and_products_do_not_depend_on_order_or_sign(one, other):
    graph = Graph()
    a, b = both(graph, one)[0], both(graph, other)[0]
    assert a + b == b + a
    assert a * b == b * a
    assert a - b == -(b - a)
    assert (-a) * b == -(a * b)
    assert (a - a).constant == 0.0


@given(TREES)
def test_no_operation_has_a_neutral_operand_and_no_node_is_there_twice(tree):
    graph = Graph()
    live = graph.live([both(graph, tree)[0]])
    assert len({graph.nodes[number] for number in live}) == len(live)
    for number in live:
        node = graph.nodes[number]
        operands = [graph.nodes[operand] for operand in node.operands]
        values = [operand.value for operand in operands if operand.kind == "constant"]
        if node.kind in ("add", "subtract", "multiply"):
            assert 0.0 not in values
            assert len(values) < 2
        if node.kind == "multiply":
            assert 1.0 not in values


def test_like_terms_meet_and_what_cancels_is_gone():
    graph = Graph()
    x, y = graph.symbol("x"), graph.symbol("y")
    assert x * 2.0 + x * 3.0 == x * 5.0
    assert x * 2.0 - x * 2.0 == graph.constant(0.0)
    assert x + (y - x) == y
    assert (x - y) + y == x
    assert (x * 2.0) * -0.5 == -x
    assert sine(-x) == -sine(x)
    assert cosine(-x) == cosine(x)


def test_operations_of_what_the_outputs_need():
    graph = Graph()
    x, y = graph.symbol("x"), graph.symbol("y")
    product = x * y
    _unused = sine(product)
    outputs = [product + x, -(product + x), product - y, cosine(x), sign(y), graph.constant(2.0)]
    counted = graph.operations(outputs)
    assert (counted.multiplications, counted.additions, counted.sines, counted.others) == (1, 2, 1, 1)


@each("value", [0.0, 1.0, -2.5])
def test_functions_of_constants_are_constants(value):
    graph = Graph()
    constant = graph.constant(value)
    assert sine(constant).constant == pytest.approx(np.sin(value))
    assert cosine(constant).constant == pytest.approx(np.cos(value))
    assert sign(constant).constant == np.sign(value)
    assert hyperbolic_tangent(constant).constant == pytest.approx(np.tanh(value))
