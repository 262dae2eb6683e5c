//! How many random cases a property is tried with.

use proptest::test_runner::{Config, RngSeed};

/// So many cases, the same in every run; `PROPTEST_CASES` and `PROPTEST_RNG_SEED` say otherwise.
pub fn cases(count: u32) -> Config {
    let given = Config::default();
    let is_given = |name: &str| std::env::var_os(name).is_some();
    Config {
        cases: if is_given("PROPTEST_CASES") { given.cases } else { count },
        rng_seed: if is_given("PROPTEST_RNG_SEED") { given.rng_seed } else { RngSeed::Fixed(1) },
        failure_persistence: None,
        ..given
    }
}
