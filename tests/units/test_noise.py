"""Repeatable noise: the published generator's words; its statistics: `rust/sim/tests/disturbances.rs`."""

from jax_aero import rust

PUBLISHED = [0xA15C02B7, 0x7B47F409, 0xBA1D3330, 0x83D2F293, 0xBFA4784B, 0xCBED606E]
"""First words of the generator's demonstration, seed 42 and stream 54."""


def test_uniform_numbers_are_words_between_zero_and_one():
    assert rust.uniforms(42, 54, 6).tolist() == [(word + 0.5) / 2**32 for word in PUBLISHED]


def test_normal_numbers_are_pairs_and_a_seed_uses_all_its_bits():
    assert rust.normals(7, 0, 5).tolist() == rust.normals(7, 0, 6).tolist()[:5]
    assert rust.normals(2**64 - 1, 0, 3).tolist() != rust.normals(2**64 - 2, 0, 3).tolist()
