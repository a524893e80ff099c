"""What all tests share: property tests draw the same examples on every run and every machine, and no test reads or
writes what the user keeps of films."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, settings

from onebend.learning import posterior

settings.register_profile(
    "same",
    derandomize=True,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.differing_executors],
)
settings.load_profile("same")

_COUNT = itertools.count()
LONGEST = (
    "test_end_to_end.py", "test_live.py", "test_setup.py", "test_body.py", "test_outcomes.py", "test_export.py",
    "test_drive.py", "test_rehearsal.py", "test_batch.py", "test_help_examples.py", "test_push_place.py",
    "test_observe.py", "test_force_sensors.py", "test_attacked.py", "test_rooms_page.py", "test_page.py",
    "test_filming_page.py", "test_driving.py", "test_strangers.py", "test_v4l2.py", "test_extras.py", "test_killed.py",
)  # fmt: skip


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest files come first, in this order: of several processes none has one of them left at the end."""
    items.sort(key=lambda item: LONGEST.index(name) if (name := item.path.name) in LONGEST else len(LONGEST))


@pytest.fixture(autouse=True, scope="session")
def _no_cache_between_tests() -> Iterator[None]:
    """Fixtures that several tests share keep nothing beyond their own folders."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ONEBEND_CACHE", "off")
        yield


@pytest.fixture(scope="module")
def no_other_places() -> Iterator[None]:
    """Fits take the push where it is written, and do not ask whether it acts elsewhere: half the time of a fit."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(posterior, "search_place", lambda *_, **__: None)
        yield


@pytest.fixture(autouse=True)
def _a_cache_of_its_own(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Each test begins with an empty cache, in a folder that nothing else uses and that is made if it is needed."""
    monkeypatch.setenv("ONEBEND_CACHE", str(tmp_path_factory.getbasetemp() / f"kept-{next(_COUNT)}"))
