//! Laws that hold for every matrix and every mechanism, on random ones and every back end of the machine. The numbers
//! drawn are the same in every run; PROPTEST_CASES and PROPTEST_RNG_SEED in the environment draw more, or others.

mod back_ends;
mod dynamics;
mod end_effector;
mod filters;
mod linear_algebra;
mod mechanisms;
mod play;

use proptest::prelude::ProptestConfig;
use proptest::test_runner::RngSeed;

/// An upper bound of a size, and the one for Miri, which takes minutes for what a processor does in milliseconds.
const fn below(size: usize, interpreted: usize) -> usize {
    if cfg!(miri) { interpreted } else { size }
}

/// A few cases, or as many as the environment says.
fn few() -> ProptestConfig {
    let given = |name: &str| std::env::var(name).ok().and_then(|text| text.parse::<u64>().ok());
    ProptestConfig {
        cases: given("PROPTEST_CASES").map_or(16, |cases| cases as u32),
        rng_seed: RngSeed::Fixed(given("PROPTEST_RNG_SEED").unwrap_or(1)),
        failure_persistence: None,
        ..ProptestConfig::default()
    }
}
