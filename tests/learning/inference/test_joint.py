"""Recordings of one beam together, each one's own parameters integrated out by themselves, against dense normal
densities with explicit inverses."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from onebend.learning.linear import JointInformation, Prior, coupled, marginal, own_in_z, prior_in_own_z, solved
from onebend.learning.normal import BlockRoot, InformationForm, beside, unit_root
from onebend.records import Array

SHARED, OWN, NUMBERS = 3, (2, 4, 0), 9  # parameters that are shared, own ones of each recording, numbers of each
SIZE = SHARED + sum(OWN)
PARTS = (slice(0, 3), slice(3, 5), slice(5, 9), slice(9, 9))


def root_of(rng: np.random.Generator, count: int) -> BlockRoot:
    """The first parameter by itself, and two that depend on each other where there are three or more."""
    if count < 3:
        return BlockRoot(rng.uniform(0.5, 2.0, count))
    return BlockRoot(rng.uniform(0.5, 2.0, count), ((np.array([2, 1]), np.array([[1.3, 0.0], [-0.4, 0.7]])),))


@pytest.mark.parametrize("where", [[1, 3, 5], [2, 3, 4], [4, 1, 3], [5, 3, 1], [0, 1, 5]])
def test_a_root_is_its_dense_matrix_wherever_its_block_stands(where: list[int]) -> None:
    rng = np.random.default_rng(1)
    block, sd, dense = np.tril(rng.standard_normal((3, 3))), rng.uniform(0.5, 2.0, 6), np.zeros((6, 6))
    np.fill_diagonal(dense, sd)
    dense[np.ix_(where, where)] = block
    root, v = BlockRoot(sd, ((np.array(where), block),)), rng.standard_normal((6, 6))
    assert root.times(v) == pytest.approx(dense @ v)
    assert root.transposed_times(v) == pytest.approx(dense.T @ v)
    assert root.around(v) == pytest.approx(dense.T @ v @ dense)


class Case:
    """`y_r = J_r x_r + noise` of each recording, dense and by recording."""

    def __init__(self, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        roots = tuple(root_of(rng, count) for count in (SHARED, *OWN))
        self.before = Prior(rng.standard_normal(SIZE), PARTS, roots)
        self.root = np.zeros((SIZE, SIZE))
        forms, rows, values = [], [], []
        for part, root in zip(PARTS, roots, strict=True):
            self.root[part, part] = root.dense()
        for part, count in zip(PARTS[1:], OWN, strict=True):
            j, y = rng.standard_normal((NUMBERS, SHARED + count)), rng.standard_normal(NUMBERS)
            sd = rng.uniform(0.5, 2.0, NUMBERS)
            forms.append(form_of(j, y, sd))
            wide = np.zeros((NUMBERS, SIZE))
            wide[:, :SHARED], wide[:, part] = j[:, :SHARED], j[:, SHARED:]
            rows.append(wide / sd[:, None])
            values.append((y / sd, float(np.sum(np.log(sd)))))
        self.data = JointInformation(tuple(forms), PARTS)
        self.j, self.y = np.concatenate(rows), np.concatenate([y for y, _ in values])
        self.log_noise = sum(noise for _, noise in values)

    @property
    def covariance(self) -> Array:
        """(P, P) after the data."""
        return np.asarray(np.linalg.inv(np.linalg.inv(self.root @ self.root.T) + self.j.T @ self.j))

    @property
    def log_evidence(self) -> float:
        """But for the constant that the code leaves out too."""
        prior = self.root @ self.root.T
        density = multivariate_normal(self.j @ self.before.mean, np.eye(len(self.y)) + self.j @ prior @ self.j.T)
        return float(density.logpdf(self.y) - self.log_noise + 0.5 * len(self.y) * np.log(2.0 * np.pi))


def form_of(j: Array, y: Array, sd: Array) -> InformationForm:
    weighted = j.T / sd**2
    return InformationForm(weighted @ j, weighted @ y, float(np.sum((y / sd) ** 2)), float(np.sum(np.log(sd))))


def test_evidence_with_own_parameters_at_their_most_probable_has_no_volume_of_theirs() -> None:
    case, own = Case(), slice(SHARED, SIZE)
    posterior, onto = solved(case.data, case.before), case.j @ case.root
    precision = np.eye(SIZE) + onto.T @ onto
    away = case.y - case.j @ case.before.mean
    least = float(away @ away - away @ onto @ np.linalg.solve(precision, onto.T @ away))
    volume = np.linalg.slogdet(precision)[1] - np.linalg.slogdet(precision[own, own])[1]
    np.testing.assert_allclose(posterior.log_evidence_of_shared, -0.5 * (least + volume))


def test_a_root_does_what_its_matrix_does() -> None:
    rng = np.random.default_rng(1)
    root = beside(root_of(rng, 2), root_of(rng, 4))
    dense, z, matrix = root.dense(), rng.standard_normal((6, 3)), rng.standard_normal((6, 6))
    assert np.count_nonzero(dense - np.diag(np.diag(dense))) == 1
    np.testing.assert_allclose(root.times(z), dense @ z)
    np.testing.assert_allclose(root.transposed_times(z), dense.T @ z)
    np.testing.assert_allclose(root.solve(z), np.linalg.solve(dense, z))
    np.testing.assert_allclose(root.around(matrix), dense.T @ matrix @ dense)
    index = np.array([4, 3, 0])
    np.testing.assert_allclose(root.take(index).dense(), dense[np.ix_(index, index)])


def test_a_root_of_one_leaves_everything_as_it_is() -> None:
    matrix = np.random.default_rng(2).standard_normal((4, 4))
    around = unit_root(4).around(matrix)
    np.testing.assert_array_equal(around, matrix)
    np.testing.assert_array_equal(unit_root(4).transposed_times(matrix), matrix)
    assert not np.shares_memory(around, matrix)  # it is added to
    assert not BlockRoot(np.ones(4), ((np.array([1, 2]), np.array([[1.0, 0.0], [0.5, 1.0]])),)).unit


def test_covariances_of_pairs_are_worked_out_where_asked_for() -> None:
    posterior = solved(Case().data, Case().before)
    pairs = posterior.covariance.pairs
    assert len(pairs) == len(list(pairs)) == len(OWN)
    for number in (2, 0, 0, 1):
        np.testing.assert_array_equal(pairs[number], posterior.pair(number))
    np.testing.assert_array_equal(pairs[1:][0], posterior.pair(1))
    assert pairs[1] is pairs[1]


def test_the_posterior_and_the_evidence_are_those_of_dense_algebra() -> None:
    case = Case()
    found, covariance = solved(case.data, case.before), case.covariance
    right = np.linalg.solve(case.root @ case.root.T, case.before.mean) + case.j.T @ case.y
    np.testing.assert_allclose(found.mean, covariance @ right, rtol=1e-9)
    assert found.log_evidence == pytest.approx(case.log_evidence, rel=1e-9)
    v = np.random.default_rng(2).standard_normal((SIZE, 2))
    np.testing.assert_allclose(found.times_covariance(v), covariance @ v, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(case.data.times(v), case.j.T @ (case.j @ v), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(case.data.vector, case.j.T @ case.y, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(case.before.times(case.before.whiten(v[:, 0])), v[:, 0] - case.before.mean)


def test_a_damping_is_added_to_every_parameters_precision() -> None:
    case = Case(3)
    whole = (1.0 + 2.5) * np.eye(SIZE) + case.root.T @ case.j.T @ case.j @ case.root
    v = np.random.default_rng(4).standard_normal(SIZE)
    np.testing.assert_allclose(solved(case.data, case.before, 2.5).solve(v), np.linalg.solve(whole, v), rtol=1e-9)


@pytest.mark.parametrize("damping", [0.0, 2.5])
def test_z_in_the_place_of_own_parameters_leaves_the_posterior_as_it_is(damping: float) -> None:
    case, v = Case(12), np.random.default_rng(13).standard_normal(SIZE)
    forms = tuple(own_in_z(form, case.before, number) for number, form in enumerate(case.data.forms))
    data, before = JointInformation(forms, PARTS), prior_in_own_z(case.before)
    found, plain = solved(data, before, damping), solved(case.data, case.before, damping)
    np.testing.assert_allclose(found.z, plain.z, rtol=1e-9)
    np.testing.assert_allclose(found.solve(v), plain.solve(v), rtol=1e-9)
    assert found.log_evidence == pytest.approx(plain.log_evidence, rel=1e-9)
    precision = case.root.T @ case.j.T @ case.j @ case.root
    x = before.times(v)
    assert x @ data.times(x) == pytest.approx(v @ precision @ v, rel=1e-9)


def test_the_covariance_is_that_of_dense_algebra_by_recording() -> None:
    case = Case(5)
    found, dense = solved(case.data, case.before).covariance, case.covariance
    for pair, part in zip(found.pairs, PARTS[1:], strict=True):
        index = np.concatenate([np.arange(SHARED), np.arange(part.start, part.stop)])
        np.testing.assert_allclose(pair, dense[np.ix_(index, index)], rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(found.diagonal, np.diag(dense), rtol=1e-8)
    np.testing.assert_allclose(found.with_shared(slice(2)), dense[:, :2], rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(found.among(slice(6, 8)), dense[6:8, 6:8], rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(found.shared_with(slice(6, 8)), dense[:SHARED, 6:8], rtol=1e-8, atol=1e-12)
    np.testing.assert_array_equal(solved(case.data, case.before).pair(1), found.pairs[1])
    with pytest.raises(ValueError, match="more than one"):
        found.among(slice(4, 6))


def test_functionals_of_different_recordings_have_the_covariance_of_dense_algebra() -> None:
    case, rng = Case(6), np.random.default_rng(7)
    rows = [(slice(0, 2), rng.standard_normal((1, 2))), (slice(5, 8), rng.standard_normal((2, 3)))]
    rows += [(slice(3, 5), rng.standard_normal((1, 2)))]
    wide = np.zeros((4, SIZE))
    wide[0, :2], wide[1:3, 5:8], wide[3, 3:5] = rows[0][1], rows[1][1], rows[2][1]
    found = solved(case.data, case.before).covariance.of_functionals(rows)
    np.testing.assert_allclose(found, wide @ case.covariance @ wide.T, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(
    "index", [([0, 2], [], [], []), ([], [1], [], []), ([], [0, 1], [1, 3], []), ([0], [1], [0, 2], [])]
)
def test_what_would_be_known_with_some_parameters_is_that_of_the_conditional_density(
    index: tuple[list[int], ...],
) -> None:
    case, rng = Case(8), np.random.default_rng(9)
    weights, dense = rng.standard_normal((2, SHARED)), case.covariance
    places = [np.array(one, dtype=np.int64) for one in index]
    away = [rng.standard_normal(len(one)) for one in places]
    found = solved(case.data, case.before).covariance.conditioned(weights, places, away)
    b = np.concatenate([part.start + one for part, one in zip(PARTS, places, strict=True)])
    inverse, across = np.linalg.inv(dense[np.ix_(b, b)]), weights @ dense[:SHARED][:, b]
    whole = np.concatenate(away)
    np.testing.assert_allclose(found.explained, np.diag(across @ inverse @ across.T), rtol=1e-6)
    np.testing.assert_allclose(found.change, across @ inverse @ whole, rtol=1e-6)
    assert found.chi_squared == pytest.approx(whole @ inverse @ whole, rel=1e-6)


def test_what_is_integrated_out_is_noise() -> None:
    """`y = J1 x1 + (J2 x2 + noise)`: x2 under its prior makes the noise larger and correlated."""
    rng = np.random.default_rng(10)
    j, y, sd = rng.standard_normal((9, 5)), rng.standard_normal(9), rng.uniform(0.5, 2.0, 9)
    mean, root, kept, others = rng.standard_normal(5), root_of(rng, 5), np.array([4, 0]), np.array([1, 2, 3])
    found = marginal(form_of(j, y, sd), mean, root, kept)
    inside = root.dense()[np.ix_(others, others)]
    noise = np.diag(sd**2) + j[:, others] @ inside @ inside.T @ j[:, others].T
    left = y - j[:, others] @ mean[others]
    np.testing.assert_allclose(found.matrix, j[:, kept].T @ np.linalg.solve(noise, j[:, kept]), rtol=1e-9)
    np.testing.assert_allclose(found.vector, j[:, kept].T @ np.linalg.solve(noise, left), rtol=1e-9)
    assert found.constant == pytest.approx(left @ np.linalg.solve(noise, left), rel=1e-9)
    assert found.log_noise == pytest.approx(0.5 * np.linalg.slogdet(noise)[1], rel=1e-9)


@pytest.mark.parametrize("recordings", [1, 3])
def test_some_own_parameters_with_all_else_integrated_out_have_the_same_evidence(recordings: int) -> None:
    case = Case(11)
    parts = PARTS[: 1 + recordings]
    data = JointInformation(case.data.forms[:recordings], parts)
    before = Prior(case.before.mean[: parts[-1].stop], parts, case.before.roots[: 1 + recordings])
    own = [np.array([0]), np.array([1, 2]), np.zeros(0, dtype=np.int64)][:recordings]
    some, left = coupled(data, before, own)
    assert left.parts[0].stop == (SHARED if recordings > 1 else 0)
    found, whole = solved(some, left), solved(data, before)
    assert found.log_evidence == pytest.approx(whole.log_evidence, rel=1e-9)
    kept = [part.start + mine for part, mine in zip(parts[1:], own, strict=True)]
    asked = np.concatenate([np.arange(left.parts[0].stop), *kept])
    np.testing.assert_allclose(found.mean, whole.mean[asked], rtol=1e-9)
