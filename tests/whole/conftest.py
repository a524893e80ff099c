"""The program under attack, and the recordings to mutilate, as in `tests/attack`."""

from tests.attack.conftest import film as film, sound as sound, tracks as tracks, victim as victim
