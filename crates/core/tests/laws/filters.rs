//! Laws of filters along channels.

use crate::{below, few};
use haptid_core::{Backend, Error, decimate, filter_both_ways};
use proptest::collection::vec;
use proptest::prelude::*;

/// Channels with their sections, and the samples by which their ends are extended.
#[derive(Debug, Clone)]
struct Filtering {
    /// Of each channel, of each section: b0 b1 b2 a1 a2.
    sections: Vec<Vec<[f64; 5]>>,
    channels: Vec<Vec<f64>>,
    padding: usize,
}

impl Filtering {
    fn made(&self, backend: Backend) -> Vec<f64> {
        let samples = self.channels[0].len();
        let numbers = |&[b0, b1, b2, a1, a2]: &[f64; 5]| [b0, b1, b2, 1.0, a1, a2];
        let sections: Vec<f64> = self.sections.iter().flatten().flat_map(numbers).collect();
        let mut out = vec![f64::NAN; self.channels.len() * samples];
        filter_both_ways(backend, &sections, &self.channels.concat(), samples, self.padding, &mut out).expect("shapes");
        out
    }

    /// By the recursion as it is written down; or what its terms add up to, which bounds its rounding.
    fn known(&self, magnitude: bool) -> Vec<f64> {
        let sign = |x: f64| if magnitude { x.abs() } else { x };
        let less = |x: f64, y: f64| if magnitude { x.abs() + y.abs() } else { x - y };
        let mut all = Vec::new();
        for (sections, x) in self.sections.iter().zip(&self.channels) {
            let last = x.len() - 1;
            let mut wide: Vec<f64> = (1..=self.padding).rev().map(|k| less(2.0 * x[0], x[k])).collect();
            wide.extend(x.iter().map(|&x| sign(x)));
            wide.extend((1..=self.padding).map(|k| less(2.0 * x[last], x[last - k])));
            for _ in 0..2 {
                let start = wide[0];
                wide.iter_mut().for_each(|x| *x = less(*x, start));
                let mut constant = start;
                for &[b0, b1, b2, a1, a2] in sections {
                    let x = wide.clone();
                    let before = |of: &[f64], k: usize, by: usize| if k < by { 0.0 } else { of[k - by] };
                    for k in 0..x.len() {
                        let forced = sign(b0) * x[k] + sign(b1) * before(&x, k, 1) + sign(b2) * before(&x, k, 2);
                        wide[k] = less(less(forced, a1 * before(&wide, k, 1)), a2 * before(&wide, k, 2));
                    }
                    let gain = if magnitude { 1.0 - a1.abs() - a2.abs() } else { 1.0 + a1 + a2 };
                    constant *= (sign(b0) + sign(b1) + sign(b2)) / gain;
                }
                wide.iter_mut().for_each(|x| *x += constant);
                wide.reverse();
            }
            all.extend_from_slice(&wide[self.padding..][..x.len()]);
        }
        all
    }
}

fn filtering() -> impl Strategy<Value = Filtering> {
    (1..below(19, 5), 0..4_usize, 2..below(60, 12)).prop_flat_map(|(many, sections, samples)| {
        let section = (vec(-1.0..1.0, 3), -0.5..0.5, -0.4..0.4);
        let own = section.prop_map(|(b, a1, a2)| [b[0], b[1], b[2], a1, a2]);
        (vec(vec(own, sections), many), vec(vec(-1.0..1.0, samples), many), 0..samples)
            .prop_map(|(sections, channels, padding)| Filtering { sections, channels, padding })
    })
}

proptest! {
    #![proptest_config(few())]

    #[test]
    fn both_passes_are_the_recursion(filtering in filtering()) {
        let (wanted, size) = (filtering.known(false), filtering.known(true));
        // Products and sums of a sample: those of three sections in two passes, each within half a unit.
        let units = 100.0 * f64::EPSILON;
        for backend in Backend::available() {
            for ((got, wanted), size) in filtering.made(backend).iter().zip(&wanted).zip(&size) {
                prop_assert!((got - wanted).abs() <= units * size, "{:?}: {} for {}", backend, got, wanted);
            }
        }
    }

    /// A channel is the same bit by bit, whatever stands beside it.
    #[test]
    fn channels_are_apart(filtering in filtering()) {
        for backend in Backend::available() {
            let alone = filtering.sections.iter().zip(&filtering.channels).flat_map(|(sections, channel)| {
                let own = Filtering { sections: vec![sections.clone()], channels: vec![channel.clone()], ..filtering };
                own.made(backend)
            });
            prop_assert_eq!(alone.collect::<Vec<_>>(), filtering.made(backend), "{:?}", backend);
        }
    }

    /// The sums as they are written down, of windows that end anywhere, and of a channel of zeros between others.
    #[test]
    fn decimated_rows_are_sums_over_windows(
        taps in vec(-1.0..1.0, 1..below(40, 10)),
        decimation in 1..below(60, 9),
        more in 0..below(70, 12),
        seen in vec(-1.0..1.0, 2 * below(110, 22)),
    ) {
        let samples = taps.len() + more;
        let channels = [&seen[..samples], &vec![0.0; samples], &seen[samples..2 * samples]];
        let windows = |x: &&[f64]| x.windows(taps.len()).step_by(decimation).map(<[f64]>::to_vec).collect::<Vec<_>>();
        let rows: Vec<Vec<f64>> = channels.iter().flat_map(windows).collect();
        for backend in Backend::available() {
            let mut out = vec![f64::NAN; rows.len()];
            decimate(backend, &channels.concat(), samples, &taps, decimation, &mut out).expect("shapes");
            for (got, window) in out.iter().zip(&rows) {
                let wanted: f64 = window.iter().zip(&taps).map(|(x, tap)| x * tap).sum();
                prop_assert!((got - wanted).abs() <= f64::EPSILON * taps.len() as f64, "{:?}: {} for {}", backend, got, wanted);
            }
        }
    }
}

#[test]
fn a_window_is_no_longer_than_a_channel() {
    let short = decimate(Backend::best(), &[1.; 2], 2, &[1.; 3], 1, &mut []);
    assert_eq!(short, Err(Error::Length { name: "channels", got: 2, wanted: 3 }));
    let still = decimate(Backend::best(), &[1.; 2], 2, &[1.; 2], 0, &mut [0.]);
    assert_eq!(still, Err(Error::Value { name: "decimation", got: 0.0, wanted: "1 or more" }));
}

#[test]
fn there_must_be_more_samples_than_an_end_is_extended_by() {
    let made = filter_both_ways(Backend::best(), &[1., 0., 0., 1., 0., 0.], &[1.; 3], 3, 3, &mut [0.; 3]);
    assert_eq!(made, Err(Error::Length { name: "channels", got: 3, wanted: 4 }));
}
