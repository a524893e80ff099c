"""What all tests share: property tests draw the same examples on every run and every machine, and no test reads or
writes what the user keeps of films."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile(
    "same",
    derandomize=True,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.differing_executors],
)
settings.load_profile("same")

_COUNT = itertools.count()


@pytest.fixture(autouse=True, scope="session")
def _no_cache_between_tests() -> Iterator[None]:
    """Fixtures that several tests share keep nothing beyond their own folders."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ONEBEND_CACHE", "off")
        yield


@pytest.fixture(autouse=True)
def _a_cache_of_its_own(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Each test begins with an empty cache, in a folder that nothing else uses and that is made if it is needed."""
    monkeypatch.setenv("ONEBEND_CACHE", str(tmp_path_factory.getbasetemp() / f"kept-{next(_COUNT)}"))
