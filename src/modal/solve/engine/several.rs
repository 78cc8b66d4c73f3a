//! Several devices: the images of a batch are shared among them in pieces. A device takes its next
//! piece when the last is done, and each piece is in proportion to its measured speed, so that all
//! end together.
//!
//! A fit depends on its own image alone: pieces change no result. The piece of a device that fails
//! is fitted again by another.

use crate::imaging::{Chain, DeviceGroup, GroupMember};
use crate::modal::solve::engine::device::DeviceEngine;
use crate::modal::solve::engine::task::{Engine, FitTask, ImageFit, Prepare};
use crate::{Error, Result};
use std::panic::resume_unwind;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// Size of a device's next piece, as a fraction of its share of the images left: the rest evens out
/// errors of the speeds.
const PIECE: f64 = 0.5;
/// The same of a device whose speed is not known yet.
const FIRST_PIECE: f64 = 0.25;
/// Smallest piece, as a fraction of an equal share of all images: a device is slow with few images
/// at once.
const LEAST_PIECE: f64 = 1.0 / 16.0;

/// Images in turn, the first of which has this place in the batch.
struct Piece<'a> {
    first: usize,
    images: &'a mut [ImageFit],
}

/// Images that no device has taken.
struct Queue<'a> {
    /// Pieces of devices that failed.
    returned: Vec<Piece<'a>>,
    rest: Piece<'a>,
    /// Images a second of each device.
    speeds: Vec<Option<f64>>,
    least: usize,
}

impl<'a> Queue<'a> {
    fn new(images: &'a mut [ImageFit], members: &[GroupMember<Chain>]) -> Self {
        let equal = images.len() as f64 / members.len() as f64;
        let speeds = members.iter().map(|member| member.images_per_s).collect();
        let least = ((LEAST_PIECE * equal).ceil() as usize).max(1);
        Self { returned: Vec::new(), rest: Piece { first: 0, images }, speeds, least }
    }

    /// The next piece of `member`; none where all are taken.
    fn take(&mut self, member: usize) -> Option<Piece<'a>> {
        if let Some(piece) = self.returned.pop() {
            return Some(piece);
        }
        let images = std::mem::take(&mut self.rest.images);
        let size = self.size(member, images.len());
        let (own, rest) = images.split_at_mut(size);
        let piece = Piece { first: self.rest.first, images: own };
        self.rest = Piece { first: piece.first + size, images: rest };
        (size > 0).then_some(piece)
    }

    /// Size of the next piece of `member`, of `left` images.
    fn size(&self, member: usize, left: usize) -> usize {
        let known: Vec<f64> = self.speeds.iter().flatten().copied().collect();
        let mean = known.iter().sum::<f64>() / known.len() as f64;
        let speed = |one: &Option<f64>| one.unwrap_or(if known.is_empty() { 1.0 } else { mean });
        let share = speed(&self.speeds[member]) / self.speeds.iter().map(speed).sum::<f64>();
        let part = if self.speeds[member].is_some() { PIECE } else { FIRST_PIECE };
        ((part * share * left as f64).ceil() as usize).max(self.least).min(left)
    }
}

/// Fits images on the devices of `group`.
///
/// # Errors
/// As [`Engine::fit`]; [`Error::Device`] where all devices have failed.
pub(super) fn fit(
    group: &mut DeviceGroup<Chain>,
    task: &FitTask,
    prepare: &Prepare,
    images: &mut [ImageFit],
) -> Result<()> {
    let mut queue = Queue::new(images, group.members_mut());
    while !queue.rest.images.is_empty() || !queue.returned.is_empty() {
        queue.speeds = group.members_mut().iter().map(|member| member.images_per_s).collect();
        let shared = Mutex::new(queue);
        let outcomes: Vec<Result<()>> = std::thread::scope(|scope| {
            let shared = &shared;
            let start = |(place, member)| scope.spawn(move || run(member, place, shared, task, prepare));
            let threads: Vec<_> = group.members_mut().iter_mut().enumerate().map(start).collect();
            threads.into_iter().map(|thread| thread.join().unwrap_or_else(|panic| resume_unwind(panic))).collect()
        });
        let mut failed = Vec::new();
        for (place, outcome) in outcomes.into_iter().enumerate() {
            match outcome {
                Ok(()) => {}
                Err(Error::Device(reason)) => failed.push((place, reason)),
                Err(error) => return Err(error),
            }
        }
        group.retire(&failed)?;
        queue = shared.into_inner().unwrap_or_else(PoisonError::into_inner);
    }
    Ok(())
}

/// Fits pieces on one device until none is left. The piece of a device that fails goes back.
fn run(
    member: &mut GroupMember<Chain>,
    place: usize,
    queue: &Mutex<Queue>,
    task: &FitTask,
    prepare: &Prepare,
) -> Result<()> {
    loop {
        let taken = lock(queue).take(place);
        let Some(Piece { first, images }) = taken else { return Ok(()) };
        let began = Instant::now();
        // A piece counts when it is done: one that is lost is fitted again.
        let silent = task.control.silent();
        let outcome = DeviceEngine::new(&mut member.chain).fit(
            &FitTask { control: &silent, ..*task },
            &|index, preparer, prepared| prepare(first + index, preparer, prepared),
            images,
        );
        match outcome {
            Ok(()) => {
                task.control.step(images.len());
                member.images_per_s = Some(images.len() as f64 / began.elapsed().as_secs_f64().max(1e-9));
                lock(queue).speeds[place] = member.images_per_s;
            }
            Err(error) => {
                let mut queue = lock(queue);
                if matches!(error, Error::Device(_)) {
                    queue.returned.push(Piece { first, images });
                } else {
                    // The others end after their piece.
                    (queue.returned, queue.rest.images) = (Vec::new(), &mut []);
                }
                return Err(error);
            }
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(all(test, debug_assertions, feature = "opencl"))]
mod device_tests;

#[cfg(test)]
mod tests {
    use super::*;

    /// A queue without images, of devices with these speeds.
    fn queue<'a>(images: usize, speeds: &[Option<f64>]) -> Queue<'a> {
        let least = images.div_ceil(16 * speeds.len()).max(1);
        Queue { returned: Vec::new(), rest: Piece { first: 0, images: &mut [] }, speeds: speeds.to_vec(), least }
    }

    #[test]
    fn pieces_are_in_proportion_to_the_measured_speeds() {
        let measured = queue(400, &[Some(30.0), Some(10.0)]);
        assert_eq!([0, 1].map(|member| measured.size(member, 400)), [150, 50]);
        // Before a device is measured it has half as much of its share; others are taken to be as
        // fast as those that are known.
        assert_eq!([0, 1].map(|member| queue(400, &[None, None]).size(member, 400)), [50, 50]);
        assert_eq!([0, 1].map(|member| queue(400, &[Some(30.0), None]).size(member, 400)), [100, 50]);
        // The last pieces are not smaller than is worth a batch, nor larger than what is left.
        assert_eq!([20, 5, 0].map(|left| measured.size(1, left)), [13, 5, 0]);
    }
}
