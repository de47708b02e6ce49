//! The regressor: columns and samples are independent of the others that are requested.

use crate::mechanisms::tree;
use haptid_core::{Backend, Mechanism, Motion, new_regressor, regressor, structural_nonzeros};
use std::mem::MaybeUninit;
use std::ops::Range;

/// Columns of the regressor at some samples; sample k is the same in every motion.
fn columns(mechanism: &Mechanism, samples: Range<usize>, accelerations: bool, chosen: &[usize]) -> Vec<f64> {
    let number = |order: usize| -> Vec<f64> {
        let at = |a: usize, k: usize| ((7 * k + 11 * a) as f64 * 0.37 + order as f64).sin();
        (0..4).flat_map(|a| samples.clone().map(move |k| at(a, k))).collect()
    };
    let (position, velocity, acceleration) = (number(0), number(1), number(2));
    let motion = Motion {
        samples: samples.len(),
        position: &position,
        velocity: &velocity,
        acceleration: accelerations.then_some(&acceleration),
        external: &[],
        loops: &[],
    };
    let mut out = vec![f64::NAN; motion.sets() * 4 * chosen.len() * samples.len()];
    regressor(mechanism, &motion, chosen, &mut out).expect("shapes");
    let mut new = vec![MaybeUninit::new(f64::NAN); out.len()];
    new_regressor(mechanism, &motion, chosen, &mut new).expect("shapes");
    // SAFETY: all have been initialised with NaN.
    assert_eq!(out, new.iter().map(|x| unsafe { x.assume_init() }).collect::<Vec<f64>>());
    out
}

#[test]
fn a_column_does_not_depend_on_the_others_requested() {
    for backend in Backend::available() {
        let (mechanism, n) = (tree(backend), 37);
        let all: Vec<usize> = (0..40).collect();
        let sets = [vec![0, 1, 2, 4, 5, 6, 7], vec![5, 6, 7], vec![7, 6], vec![9, 0, 3], vec![8]];
        for accelerations in [true, false] {
            let whole = columns(&mechanism, 0..n, accelerations, &all);
            for set in &sets {
                let chosen: Vec<usize> = (0..4).flat_map(|i| set.iter().map(move |p| 10 * i + p)).collect();
                let some = columns(&mechanism, 0..n, accelerations, &chosen);
                for (entry, run) in some.chunks_exact(n).enumerate() {
                    let (row, column) = (entry / chosen.len(), chosen[entry % chosen.len()]);
                    assert_eq!(run, &whole[(row * 40 + column) * n..][..n], "{backend:?} {row} {column}");
                }
            }
        }
    }
}

#[test]
fn a_sample_does_not_depend_on_the_length_of_the_motion() {
    let (mechanism, long, short) = (tree(Backend::best()), 7001, 2999);
    let all: Vec<usize> = (0..40).collect();
    // A regressor of more than 2^20 numbers is written another way.
    assert!(4 * all.len() * long > 1 << 20 && 4 * all.len() * short <= 1 << 20);
    let whole = columns(&mechanism, 0..long, true, &all);
    for from in [0, 1234, long - short] {
        let part = columns(&mechanism, from..from + short, true, &all);
        for (part, whole) in part.chunks_exact(short).zip(whole.chunks_exact(long)) {
            assert_eq!(part, &whole[from..from + short]);
        }
    }
}

#[test]
fn entries_that_are_zero_by_structure_are_zero() {
    for backend in Backend::available() {
        let (mechanism, n) = (tree(backend), 37);
        let all: Vec<usize> = (0..40).collect();
        let (nonzero, whole) =
            (structural_nonzeros(&mechanism, &all).expect("columns"), columns(&mechanism, 0..n, true, &all));
        for (nonzero, run) in nonzero.iter().zip(whole.chunks_exact(n)) {
            assert!(*nonzero || run.iter().all(|&x| x == 0.0), "{backend:?}");
        }
    }
}
