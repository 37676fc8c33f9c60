"""The seven ill-posed problems have the properties that their sources publish."""

import numpy as np
import pytest

from tests.inverse.linear.problems import PROBLEMS, cell_integrals, midpoints

N = 64


def galerkin(function, low, high):
    middles, width = midpoints(N, low, high)
    return cell_integrals(function, middles, width) / np.sqrt(width)


def test_data_are_the_published_closed_forms():
    """Where the source has the data in closed form: to the error of the discretisation, which falls
    with the square of the width."""

    def of_phillips(s):
        smooth = (6 - np.abs(s)) * (1 + np.cos(np.pi * s / 3) / 2)
        return smooth + 9 / (2 * np.pi) * np.sin(np.pi * np.abs(s) / 3)

    s, _ = midpoints(N, 0.0, 1.0)
    wanted = {
        "phillips": galerkin(of_phillips, -6.0, 6.0),
        "deriv2": galerkin(lambda s: (s**3 - s) / 6, 0.0, 1.0),
        "baart": galerkin(lambda s: 2 * np.sinh(s) / s, 0.0, np.pi / 2),
        "foxgood": ((1 + s**2) ** 1.5 - s**3) / 3,
    }
    for name, exact in wanted.items():
        wrong = PROBLEMS[name](N).data - exact
        assert np.linalg.norm(wrong) < 4 / N**2 * np.linalg.norm(exact), name


@pytest.mark.parametrize("name", ["shaw", "phillips", "deriv2", "gravity", "foxgood"])
def test_kernels_of_symmetric_arguments_are_symmetric_matrices(name):
    matrix = PROBLEMS[name](N).matrix
    assert np.allclose(matrix, matrix.T, rtol=0, atol=1e-14)


def test_green_function_has_the_eigenvalues_of_the_second_derivative():
    """-1/(pi k)^2 in the limit; a Galerkin method with steps is right to the width squared."""
    values = np.linalg.eigvalsh(PROBLEMS["deriv2"](N).matrix)
    k = np.arange(1, 5)
    assert np.allclose(values[:4], -1 / (np.pi * k) ** 2, rtol=(np.pi * 4 / N) ** 2)


def test_heat_goes_forward_in_time():
    matrix = PROBLEMS["heat"](N).matrix
    assert np.array_equal(matrix, np.tril(matrix))


def test_shaw_is_symmetric_about_its_middle():
    matrix = PROBLEMS["shaw"](N).matrix
    assert np.allclose(matrix, matrix[::-1, ::-1], rtol=0, atol=1e-14)


@pytest.mark.parametrize("name", ["shaw", "gravity", "baart", "foxgood"])
def test_severely_ill_posed_problems_are_singular_to_rounding(name):
    assert np.linalg.cond(PROBLEMS[name](N).matrix) > 1e14


@pytest.mark.parametrize("name", ["phillips", "deriv2"])
def test_mildly_ill_posed_problems_are_not(name):
    assert np.linalg.cond(PROBLEMS[name](N).matrix) < 1e9
