"""The four-layer network in numpy against torch.nn, its Jacobian and its starts."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from kincal.learning.network import Network, Sizes, count, initial_weights, split
from kincal.learning.transfer import new_network

SIZES = st.tuples(*[st.integers(1, 9)] * 4)


def random_network(sizes: Sizes, seed: int = 0) -> Network:
    random = np.random.default_rng(seed)
    n_in, n_out = sizes[0], sizes[3]
    scales = random.uniform(0.1, 3.0, n_in), random.uniform(0.01, 5.0, n_out)
    return Network(sizes, initial_weights(sizes, random), random.normal(size=n_in), *scales)


def inputs(network: Network, n: int, seed: int = 1) -> np.ndarray:
    scaled = np.random.default_rng(seed).uniform(-1.5, 1.5, (n, network.sizes[0]))
    return network.input_centre + network.input_scale * scaled


def as_torch(network: Network) -> torch.nn.Sequential:
    """torch's own layers with the same weights, laid out as torch's parameters_to_vector has them."""
    n_in, first, second, n_out = network.sizes
    linear = torch.nn.Linear
    layers = [linear(n_in, first), torch.nn.Tanh(), linear(first, second), torch.nn.Tanh(), linear(second, n_out)]
    found = torch.nn.Sequential(*layers).double()
    torch.nn.utils.vector_to_parameters(torch.from_numpy(network.weights), found.parameters())
    return found


@given(sizes=SIZES, seed=st.integers(0, 99))
def test_forward_pass(sizes, seed):
    """Against torch.nn.Linear and Tanh, inputs and outputs scaled by hand."""
    network = random_network(sizes, seed)
    x = inputs(network, 7)
    with torch.no_grad():
        scaled = torch.from_numpy((x - network.input_centre) / network.input_scale)
        expected = as_torch(network)(scaled).numpy() * network.output_scale
    np.testing.assert_allclose(network(x), expected, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("hidden", [1, 8])
def test_jacobian(hidden, central_difference):
    """Against central differences of fourth order, at points inside and outside of the training range."""
    network = random_network((3, hidden, hidden, 2))
    for x in inputs(network, 5):
        expected = central_difference(network, x)
        np.testing.assert_allclose(network.jacobian(x[None])[0], expected, rtol=1e-7, atol=1e-9)


@given(sizes=SIZES)
def test_split_and_count(sizes):
    """Against the number of torch's parameters; the parts, put end to end, are the weights again."""
    weights = np.arange(count(sizes), dtype=float)
    network = Network(sizes, weights, np.zeros(sizes[0]), np.ones(sizes[0]), np.ones(sizes[3]))
    assert len(weights) == sum(p.numel() for p in as_torch(network).parameters())
    parts = split(weights, sizes)
    for part, expected in zip(parts, as_torch(network).parameters(), strict=True):
        np.testing.assert_array_equal(part, expected.detach().numpy())
    np.testing.assert_array_equal(np.concatenate([part.ravel() for part in parts]), weights)


def test_split_of_a_batch_is_a_view():
    """Batches of weights (5, 2, n) split along their last axis; writing to a part writes to the weights."""
    sizes = (3, 4, 4, 2)
    weights = np.random.default_rng(0).normal(size=(5, 2, count(sizes)))
    for part, alone in zip(split(weights, sizes), split(weights[3, 1], sizes), strict=True):
        np.testing.assert_array_equal(part[3, 1], alone)
    split(weights[0, 0], sizes)[4][:] = 7.0
    assert np.sum(weights == 7.0) == 8


def test_initial_weights():
    """The same for the same seed; and every hidden unit bends within the inputs' range."""
    sizes = (3, 16, 16, 3)
    weights = initial_weights(sizes, np.random.default_rng(3))
    assert np.all(weights != 0)
    np.testing.assert_array_equal(weights, initial_weights(sizes, np.random.default_rng(3)))
    assert np.any(weights != initial_weights(sizes, np.random.default_rng(4)))
    w1, b1, *_ = split(weights, sizes)
    x = np.random.default_rng(5).uniform(-1, 1, (500, 3))
    slope = 1 - np.tanh(x @ w1.T + b1) ** 2
    assert slope.max(axis=0).min() > 0.5
    assert slope.mean() > 0.25


def test_an_output_that_the_source_task_holds_still_is_scaled_with_the_others():
    """A hundredth of the largest: what stands still as drawn moves as built, and must not outweigh all the rest."""
    joints = np.random.default_rng(0).uniform(0.2, 0.4, (20, 2))
    outputs = np.column_stack([joints[:, 0], 1e-17 * joints[:, 1], -3.0 * joints[:, 1]])
    scale = new_network(joints, outputs, 4, seed=0).output_scale
    largest = np.abs(outputs).max(axis=0)
    np.testing.assert_array_equal(scale, [largest[0], 0.01 * largest[2], largest[2]])
