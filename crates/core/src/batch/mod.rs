//! Batches: a few samples that pass through the mechanism together, with their channels, and how joints and terms
//! follow them.
//!
//! Control flow runs once per batch, arithmetic once per lane: the inner loops run over the lanes of a batch and know
//! everything else beforehand. A batch is small enough for a link, its parent and their axes to stay in the first-level
//! cache.
//!
//! Safety: whoever makes a [`Batch`] has advanced its channels to its samples. Then every channel is readable for whole
//! lanes up to `samples`, at most [`BATCH`], and [`Batch::lanes`] gives samples k with `k + T::WIDTH <= BATCH`. Unsafe
//! functions that take a batch rely on this, and on slots being those of a workspace that has grown to the batch's
//! mechanism.
//!
//! No pointer outlives a call. What a thread keeps between calls are workspaces; the only pointers in them are those of
//! [`Channels`], which [`Channels::release`] forgets at the end of each call, and [`no_pointers`] checks the rest. All
//! other types that hold pointers are arguments on the stack, or borrow what they point to.

pub(crate) mod axis;
pub(crate) mod link;
pub(crate) mod link_velocity;
pub(crate) mod sink;
pub(crate) mod sweep;

use crate::mechanism::Mechanism;
use crate::mechanism::closure::{JointMap, Rate};
use crate::mechanism::motion::Motion;
use crate::memory::slot::{BATCH, Slot, grow, store};
use crate::simd::inlined;
use crate::simd::lane::{Lane, MAX_WIDTH};
use crate::simd::token::Simd;

/// Fails to compile where a type holds a raw pointer: such types are not `Send`.
pub(crate) const fn no_pointers<T: Send>() {}

/// Channels of a motion: positions, velocities and accelerations of the coordinates, external columns, then loops.
/// Samples that are no whole lanes, and absent channels, are staged as copies.
#[derive(Default)]
pub(crate) struct Channels {
    first: Vec<*const f64>,
    copies: Vec<Slot>,
}

impl Channels {
    pub(crate) fn grow(&mut self, mechanism: &Mechanism) {
        let count = 3 * mechanism.coordinates + mechanism.externals + mechanism.loops;
        grow(&mut self.first, count, core::ptr::null());
        grow(&mut self.copies, count, Slot::ZERO);
    }

    /// Point at samples `from..from + count`, at most a batch. The pointers are valid while the motion is borrowed.
    pub(crate) fn advance_to(&mut self, mechanism: &Mechanism, motion: &Motion, from: usize, count: usize) {
        debug_assert!(0 < count && count <= BATCH && from + count <= motion.samples);
        let (na, n) = (mechanism.coordinates, motion.samples);
        let acceleration = motion.acceleration.unwrap_or_default();
        let own = [(motion.external, mechanism.externals), (motion.loops, mechanism.loops)];
        let groups = [(motion.position, na), (motion.velocity, na), (acceleration, na)].into_iter().chain(own);
        let channels = groups.flat_map(|(data, rows)| (0..rows).map(move |a| (data, a * n + from)));
        for (((data, at), first), copy) in channels.zip(&mut self.first).zip(&mut self.copies) {
            let copy = &mut copy.0;
            // Absent accelerations are zero; the last sample is repeated up to a whole lane.
            *first = match data.get(at..at + count) {
                Some(source) if count.is_multiple_of(MAX_WIDTH) => source.as_ptr(),
                Some(source) => {
                    copy[..count].copy_from_slice(source);
                    copy[count..].fill(source[count - 1]);
                    copy.as_ptr()
                }
                None => {
                    copy.fill(0.0);
                    copy.as_ptr()
                }
            };
        }
    }

    /// Forget the motion: no pointer to it outlives the call that borrows it.
    pub(crate) fn release(&mut self) {
        self.first.clear();
    }

    #[cfg(test)]
    pub(crate) fn is_released(&self) -> bool {
        self.first.is_empty()
    }

    /// The samples of a channel, readable for whole lanes until the next call of `advance_to`.
    #[inline(always)]
    pub(crate) fn channel(&self, channel: usize) -> *const f64 {
        self.first[channel]
    }
}

/// Position, velocity and acceleration of a joint, or of a term's displacement, at every sample of a batch.
#[derive(Clone, Copy)]
pub(crate) struct JointChannels([*const f64; 3]);

impl JointChannels {
    /// Lanes of the three channels, from sample `k` on.
    ///
    /// # Safety
    ///
    /// `k` is one of the batch's lanes.
    #[inline(always)]
    pub(crate) unsafe fn at<T: Lane>(&self, simd: Simd<T>, k: usize) -> [T; 3] {
        // SAFETY: the channels are readable at every lane of the batch.
        inlined::map(self.0, |first| unsafe { simd.load(first.add(k)) })
    }
}

/// Up to [`BATCH`] samples of a motion; see the head of the module for what its maker guarantees.
#[derive(Clone, Copy)]
pub(crate) struct Batch<'a> {
    pub(crate) mechanism: &'a Mechanism,
    pub(crate) channels: &'a Channels,
    pub(crate) samples: usize,
}

impl Batch<'_> {
    /// First samples of the lanes.
    #[inline(always)]
    pub(crate) fn lanes<T: Lane>(&self, _: Simd<T>) -> impl Iterator<Item = usize> {
        // A plain range is unrolled better than `step_by`.
        (0..self.samples.div_ceil(T::WIDTH)).map(|lane| lane * T::WIDTH)
    }

    /// A lane of a rate.
    ///
    /// # Safety
    ///
    /// `k` is one of the batch's lanes.
    #[inline(always)]
    pub(crate) unsafe fn rate<T: Lane>(&self, simd: Simd<T>, rate: Rate, k: usize) -> T {
        match rate {
            Rate::Constant(rate) => simd.splat(rate),
            // SAFETY: channels are readable at every lane of the batch.
            Rate::Varying { rate, .. } => unsafe { simd.load(self.channels.channel(rate).add(k)) },
        }
    }

    /// A lane of a rate's time derivative, where the rate varies.
    ///
    /// # Safety
    ///
    /// As for [`Batch::rate`].
    #[inline(always)]
    pub(crate) unsafe fn rate_derivative<T: Lane>(&self, simd: Simd<T>, rate: Rate, k: usize) -> Option<T> {
        match rate {
            Rate::Constant(_) => None,
            // SAFETY: channels are readable at every lane of the batch.
            Rate::Varying { derivative, .. } => Some(unsafe { simd.load(self.channels.channel(derivative).add(k)) }),
        }
    }

    /// Evaluate a joint map: by reference where it is a coordinate itself, otherwise into `slots`.
    ///
    /// # Safety
    ///
    /// The channels are readable at every lane, and nobody else uses `slots`.
    #[inline(always)]
    pub(crate) unsafe fn follow<T: Lane>(
        &self,
        simd: Simd<T>,
        joint_map: &JointMap,
        slots: &mut [Slot; 3],
    ) -> JointChannels {
        let na = self.mechanism.coordinates;
        if let (None, 0.0, [(a, Rate::Constant(1.0))]) = (joint_map.given, joint_map.offset, &joint_map.rates[..]) {
            return JointChannels([0, 1, 2].map(|order| self.channels.channel(order * na + a)));
        }
        for k in self.lanes(simd) {
            let mut x = [simd.splat(joint_map.offset), simd.splat(0.0), simd.splat(0.0)];
            for &(a, rate) in &joint_map.rates {
                // SAFETY: k is one of the batch's lanes, here and below: its channels are readable.
                let weight: T = unsafe { self.rate(simd, rate, k) };
                for (order, x) in x.iter_mut().enumerate() {
                    // SAFETY: as above.
                    *x = unsafe { simd.load(self.channels.channel(order * na + a).add(k)) }.fma(weight, *x);
                }
                // SAFETY: as above.
                if let Some(change) = unsafe { self.rate_derivative(simd, rate, k) } {
                    // SAFETY: as above.
                    x[2] = unsafe { simd.load(self.channels.channel(na + a).add(k)) }.fma(change, x[2]);
                }
            }
            if let Some(position) = joint_map.given {
                // SAFETY: as above.
                x[0] = unsafe { simd.load(self.channels.channel(position).add(k)) };
            }
            // SAFETY: `slots` are three, and `lanes` leaves room for a lane.
            unsafe { store(slots.as_mut_ptr(), k, x) };
        }
        JointChannels(inlined::from_fn(|order| slots[order].0.as_ptr()))
    }
}
