//! R factors against the rows that they are made of.

use crate::mechanisms::{Channels, assert_close, closed_chain};
use haptid_core::{Backend, Reduction, r_factor, reduce, regressor};

const SAMPLES: usize = 700;
const COLUMNS: [usize; 10] = [5, 6, 17, 19, 27, 39, 40, 42, 46, 48];

/// R'R of row-major square factors.
fn gram(r: &[f64], size: usize) -> Vec<f64> {
    let entry = |at: usize| (0..size).map(|k| r[k * size + at / size] * r[k * size + at % size]).sum();
    (0..size * size).map(entry).collect()
}

/// Rows as the reduction defines them: filtered, decimated, weighted; [reached columns, torque] of one motor.
fn rows(channels: &[Vec<f64>], taps: &[&[f64]], (decimation, count): (usize, usize), weights: &[f64]) -> Vec<Vec<f64>> {
    let filtered = |row: usize, channel: &[f64], taps: &[f64]| -> f64 {
        taps.iter().enumerate().map(|(k, tap)| tap * channel[row * decimation + k]).sum()
    };
    let sum = |row: usize, channel: &Vec<f64>| -> f64 {
        let parts = channel.chunks_exact(SAMPLES).zip(taps);
        parts.map(|(part, taps)| filtered(row, part, taps)).sum::<f64>() * weights[row]
    };
    (0..count).map(|row| channels.iter().map(|channel| sum(row, channel)).collect()).collect()
}

#[test]
fn r_factors_keep_the_inner_products_of_filtered_and_weighted_rows() {
    let taps: Vec<f64> = (0..21).map(|k| 0.1 * (1.0 + (f64::from(k) * 0.3).sin())).collect();
    let slope: Vec<f64> = (0..21).map(|k| (f64::from(k) - 10.0) * 0.01).collect();
    let (decimation, count, block) = (3, (SAMPLES - 20) / 3, 100);
    let weights: Vec<f64> = (0..3 * count).map(|k| if k % 7 == 0 { 0.0 } else { 1.0 + (k % 5) as f64 }).collect();
    let torque: Vec<f64> = (0..3 * SAMPLES).map(|k| (k as f64 * 0.9).cos()).collect();
    for (backend, varying) in Backend::available().into_iter().flat_map(|b| [(b, false), (b, true)]) {
        for accelerations in [true, false] {
            let (mechanism, channels) = (closed_chain(backend, varying), Channels::new(SAMPLES, varying));
            let motion = channels.motion(accelerations);
            let p = COLUMNS.len();
            let mut y = vec![0.0; motion.sets() * 3 * p * SAMPLES];
            regressor(&mechanism, &motion, &COLUMNS, &mut y).expect("shapes");
            let reduction = Reduction {
                columns: &COLUMNS,
                torque: &torque,
                taps: &taps,
                derivative_taps: if accelerations { &[] } else { &slope },
                decimation,
                first: 10,
                rows: count,
                block,
                weights: &weights,
            };
            let factors = reduce(&mechanism, &motion, &reduction).expect("shapes");
            for (a, motor) in factors.iter().enumerate() {
                let run = |set: usize, c: usize| &y[((set * 3 + a) * p + c) * SAMPLES..][..SAMPLES];
                // Momenta pass the derivative's taps, the remainder passes the filter's own, as torques do.
                let column = |&c: &usize| (0..motion.sets()).rev().flat_map(|set| run(set, c).to_vec()).collect();
                let mut columns: Vec<Vec<f64>> = motor.columns.iter().map(column).collect();
                columns.push(torque[a * SAMPLES..][..SAMPLES].to_vec());
                let made = rows(&columns, &[&taps, &slope], (decimation, count), &weights[a * count..][..count]);
                let size = columns.len();
                assert_eq!(motor.blocks.len(), count.div_ceil(block));
                for (rows, r) in made.chunks(block).zip(&motor.blocks) {
                    let product = |at: usize| rows.iter().map(|row| row[at / size] * row[at % size]).sum();
                    let wanted: Vec<f64> = (0..size * size).map(product).collect();
                    assert_close(&gram(r, size), &wanted, 1e-11, &format!("{backend:?} {varying} {accelerations}"));
                }
            }
        }
    }
}

/// A reduction of a whole motion, with this filter.
fn whole<'a>(samples: usize, torque: &'a [f64], taps: &'a [f64], decimation: usize) -> Reduction<'a> {
    let rows = (samples - taps.len()) / decimation + 1;
    let first = taps.len() / 2;
    Reduction {
        columns: &COLUMNS,
        torque,
        taps,
        derivative_taps: &[],
        decimation,
        first,
        rows,
        block: rows,
        weights: &[],
    }
}

/// Long blocks are reduced in several tasks; the number of threads does not matter.
#[test]
fn factors_do_not_depend_on_the_number_of_threads() {
    let (mechanism, channels) = (closed_chain(Backend::best(), false), Channels::new(20_011, false));
    let torque: Vec<f64> = (0..3 * channels.samples).map(|k| (k as f64 * 0.9).cos()).collect();
    let taps: Vec<f64> = (0..27).map(|k| 0.1 + (f64::from(k) * 0.3).sin()).collect();
    for (taps, decimation, block) in [(&[1.0][..], 1, usize::MAX), (&taps, 1, 5000), (&taps, 3, 70)] {
        let reduction = Reduction { block, ..whole(channels.samples, &torque, taps, decimation) };
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            pool.install(|| reduce(&mechanism, &channels.motion(true), &reduction).expect("shapes"))
        };
        assert_eq!(run(1), run(3));
    }
}

/// Long blocks without a filter are reduced by Gram matrices, short ones by reflections.
#[test]
fn long_blocks_have_the_inner_products_of_short_ones() {
    let channels = Channels::new(5003, false);
    let n = channels.samples;
    let smooth: Vec<f64> = (0..3 * n).map(|k| (k as f64 * 0.9).cos()).collect();
    let mut burst = smooth.clone();
    burst[n - 3..n].fill(1e9);
    let mut missing = smooth.clone();
    missing[n + 700] = f64::NAN;
    let dropped: Vec<f64> = (0..3 * n).map(|k| if k % 7 == 0 { 0.0 } else { 1.5 }).collect();
    assert_eq!((n + 700) % 7, 5, "the missing sample counts unless it is dropped");
    let kept_out: Vec<f64> = (0..3 * n).map(|k| if k == n + 700 { 0.0 } else { 1.0 }).collect();
    for backend in Backend::available() {
        let mechanism = closed_chain(backend, false);
        for (torque, weights) in [(&smooth, &[][..]), (&burst, &[]), (&smooth, &dropped), (&missing, &kept_out)] {
            let long = Reduction { weights, ..whole(n, torque, &[1.0], 1) };
            let made =
                |block| reduce(&mechanism, &channels.motion(true), &Reduction { block, ..long }).expect("shapes");
            for (long, short) in made(n).iter().zip(made(500)) {
                let size = long.columns.len() + 1;
                let mut wanted = vec![0.0; size * size];
                for block in &short.blocks {
                    wanted.iter_mut().zip(gram(block, size)).for_each(|(sum, x)| *sum += x);
                }
                let got = gram(&long.blocks[0], size);
                let length = |k: usize| wanted[k * size + k].sqrt().max(1e-100);
                for k in 0..size * size {
                    let apart = (got[k] - wanted[k]).abs() / (length(k / size) * length(k % size));
                    assert!(apart < 1e-12, "{backend:?} {k}: {apart}");
                }
            }
        }
        // Without a weight of zero what is missing is told, by the motor that it belongs to.
        let made = reduce(&mechanism, &channels.motion(true), &whole(n, &missing, &[1.0], 1)).expect("shapes");
        let finite: Vec<bool> = made.iter().map(|motor| motor.blocks[0].iter().all(|x| x.is_finite())).collect();
        assert_eq!(finite, [true, false, true]);
    }
}

#[test]
fn the_r_factor_keeps_the_inner_products_of_any_number_of_rows() {
    let columns = 5;
    for (backend, many) in
        Backend::available().into_iter().flat_map(|backend| [0, 1, 4, 5, 8, 256, 600].map(|many| (backend, many)))
    {
        let rows: Vec<f64> = (0..many * columns).map(|k| (k as f64 * 0.7).sin() + 0.1 * (k % 7) as f64).collect();
        let mut r = vec![f64::NAN; columns * columns];
        r_factor(backend, &rows, columns, &mut r).expect("shapes");
        let product = |a: &[f64], i: usize, j: usize| -> f64 { a.chunks(columns).map(|x| x[i] * x[j]).sum() };
        for (i, j) in (0..columns).flat_map(|i| (0..columns).map(move |j| (i, j))) {
            assert!((product(&rows, i, j) - product(&r, i, j)).abs() < 1e-12 * (1 + many) as f64, "{many} {i} {j}");
            assert!(i <= j || r[i * columns + j] == 0.0);
        }
    }
    assert!(r_factor(Backend::best(), &[1.0; 7], 5, &mut [0.0; 25]).is_err());
    assert!(r_factor(Backend::best(), &[], 0, &mut []).is_ok());
}
