"""Repeatable noise: the published generator's words, and what is made of them."""

from __future__ import annotations

import numpy as np
import pytest

from jax_aero import noise

PUBLISHED = [0xA15C02B7, 0x7B47F409, 0xBA1D3330, 0x83D2F293, 0xBFA4784B, 0xCBED606E]
"""First words of the generator's demonstration, seed 42 and stream 54; the crate is tested on the same."""


@pytest.mark.parametrize("count", range(7))
def test_the_words_of_the_published_generator(count):
    assert noise.words(42, 54, count).tolist() == PUBLISHED[:count]


def test_uniform_numbers_are_words_between_zero_and_one():
    assert noise.uniforms(42, 54, 2).tolist() == [(word + 0.5) / 2**32 for word in PUBLISHED[:2]]


def test_normal_numbers_are_normal_and_repeatable():
    drawn = noise.normals(7, 0, 20_001)
    assert np.array_equal(drawn[:99], noise.normals(7, 0, 99))
    assert not np.array_equal(drawn[:99], noise.normals(8, 0, 99))
    assert not np.array_equal(drawn[:99], noise.normals(7, 1, 99))
    assert abs(drawn.mean()) < 0.03
    assert abs(drawn.var() - 1.0) < 0.05
    assert abs(np.mean(drawn[1:] * drawn[:-1])) < 0.03
    assert abs(np.mean(np.abs(drawn) > 2.0) - 0.0455) < 0.006


def test_a_seed_may_use_all_its_bits():
    assert noise.words(2**64 - 1, 0, 3).tolist() != noise.words(2**64 - 2, 0, 3).tolist()
