//! Controller: turns the slopes of a frame into the next commands.

use super::step_map::{StepMap, StepMapWorkspace};
use crate::scene::LoopLag;
use crate::{Error, Result};
use ndarray::ArrayView1;
use std::sync::Arc;

/// Linear recursion of the control law, L = `lag.frames`: the slopes of frame k determine the
/// command of frame k + L, `c[k+L] = retained · c[k+L−1] + matrix · (slopes[k], m[k])`, clipped to
/// the stroke. On the mirror in frame k is the mean `m[k] = (1 − newer)·c[k] + newer·c[k+1]`, since
/// the next command takes effect within the frame; c[k] itself for a whole lag.
#[derive(Debug)]
pub(super) struct ControlStep {
    /// Number of slopes in a frame.
    pub slopes: usize,
    /// Number of commands.
    pub actuators: usize,
    /// Frames from a measurement to its correction.
    pub lag: LoopLag,
    /// Fraction of the last command that the next one keeps.
    pub retained: f32,
    /// The map from the slopes, and from the command that was on the mirror while they were
    /// measured.
    pub matrix: StepMap,
    /// Largest absolute command, nm; infinite for no limit.
    pub stroke_limit_nm: f32,
}

/// State of a controller; [`ControlLaw::start`](super::ControlLaw::start) creates it.
#[derive(Debug, Clone)]
pub struct Controller {
    step: Arc<ControlStep>,
    /// Ring of the `lag.frames` next commands; that of the present frame is at `now`.
    queue: Vec<Vec<f32>>,
    now: usize,
    /// Mean of the commands on the mirror in the present frame; empty for a whole number of frames.
    mixed: Vec<f32>,
    workspace: StepMapWorkspace,
}

impl Controller {
    pub(super) fn new(step: Arc<ControlStep>) -> Self {
        let queue = vec![vec![0.0; step.actuators]; step.lag.frames];
        let mixed = vec![0.0; if step.lag.newer == 0.0 { 0 } else { step.actuators }];
        Self { queue, now: 0, mixed, workspace: step.matrix.workspace(), step }
    }

    /// Advances by one frame. `slopes` (x of every subaperture, then y) were measured with the
    /// present [`commands_nm`](Self::commands_nm) on the mirror. A command beyond the stroke is
    /// clipped, and the recursion continues from the clipped command, so the integrator does not
    /// wind up. Does not allocate.
    ///
    /// NaN slopes are not rejected; they make the commands NaN.
    ///
    /// # Errors
    /// [`Error::Shape`] for a wrong number of slopes; the state is then unchanged.
    pub fn step(&mut self, slopes: &[f32]) -> Result<()> {
        let step = &*self.step;
        if slopes.len() != step.slopes {
            let (given, needed) = (slopes.len(), step.slopes);
            return Err(Error::Shape(format!("{given} slopes were given; the controller needs {needed}")));
        }
        let present = if step.lag.newer == 0.0 { &self.queue[self.now] } else { &self.mixed };
        let change = step.matrix.apply(slopes, present, &mut self.workspace);
        let last = (self.now + step.lag.frames - 1) % step.lag.frames;
        let limit = step.stroke_limit_nm;
        // The new command replaces that of the frame that ends; with a lag of 1 the latter is also
        // the last command.
        for (i, change) in change.iter().enumerate() {
            self.queue[self.now][i] = step.retained.mul_add(self.queue[last][i], *change).clamp(-limit, limit);
        }
        self.now = (self.now + 1) % step.lag.frames;
        if step.lag.newer != 0.0 {
            // A fraction of a frame has a lag of two frames at least.
            let (now, next) = (&self.queue[self.now], &self.queue[(self.now + 1) % step.lag.frames]);
            let newer = step.lag.newer as f32;
            for ((mixed, now), next) in self.mixed.iter_mut().zip(now).zip(next) {
                *mixed = newer.mul_add(next - now, *now);
            }
        }
        Ok(())
    }

    /// Divides the controlled modes by these optical gains from now on, where the law has any.
    pub(in crate::ao) fn set_optical_gains(&mut self, gains: &[f32]) {
        if let StepMapWorkspace::Modal(workspace) = &mut self.workspace {
            workspace.divide_by(gains);
        }
    }

    /// Holds the mirror at these commands, nm, as if they had been on it in every frame before.
    pub(in crate::ao) fn hold(&mut self, commands_nm: ArrayView1<f64>) {
        for commands in self.queue.iter_mut().chain([&mut self.mixed]) {
            commands.iter_mut().zip(commands_nm).for_each(|(out, &nm)| *out = nm as f32);
        }
    }

    /// The last commands that were calculated, nm: on the mirror after the lag.
    pub(in crate::ao) fn newest_nm(&self) -> &[f32] {
        &self.queue[(self.now + self.step.lag.frames - 1) % self.step.lag.frames]
    }

    /// Commands on the mirror in the coming frame, nm of wavefront; their mean where one takes
    /// effect within the frame.
    pub fn commands_nm(&self) -> &[f32] {
        if self.step.lag.newer == 0.0 { &self.queue[self.now] } else { &self.mixed }
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Bench, scene};
    use super::super::{ControlLaw, Plant};
    use super::*;
    use crate::Error;
    use crate::scene::ControlScene;
    use ndarray::{Array1, Array2};

    fn start(bench: &Bench, keys: &str) -> (ControlLaw, Controller) {
        let law = ControlLaw::new(&scene(keys), &bench.plant()).unwrap();
        let controller = law.start();
        (law, controller)
    }

    /// Pseudo-random slopes in [−1, 1].
    fn irregular(count: usize, seed: usize) -> Vec<f32> {
        (0..count).map(|i| ((i * 37 + seed * 101) as f32).sin()).collect()
    }

    /// Largest difference, relative to the largest value.
    fn relative_difference(a: &[f32], b: &[f32]) -> f32 {
        let largest = a.iter().fold(0f32, |largest, a| largest.max(a.abs()));
        a.iter().zip(b).fold(0f32, |worst, (a, b)| worst.max((a - b).abs())) / largest
    }

    #[test]
    fn an_impulse_arrives_after_the_lag_and_stays() {
        let bench = Bench::small();
        for lag in [1, 2, 5] {
            let (law, mut controller) = start(&bench, &format!("filtered_modes = 2\nlag_frames = {lag}"));
            let impulse = irregular(32, 1);
            let slopes: Array1<f64> = impulse.iter().map(|&slope| f64::from(slope)).collect();
            let expected: Vec<f32> = law.command_matrix().dot(&slopes).iter().map(|c| (0.3 * c) as f32).collect();
            let zeros = vec![0.0; 32];
            for frame in 1..lag + 5 {
                controller.step(if frame == 1 { &impulse } else { &zeros }).unwrap();
                if frame < lag {
                    assert!(controller.commands_nm().iter().all(|&command| command == 0.0), "lag {lag}, frame {frame}");
                } else {
                    // R and the sums are in single precision: a few ε = 1e-7 of the terms, which
                    // cancel by less than a factor of ten.
                    let error = relative_difference(&expected, controller.commands_nm());
                    assert!(error < 1e-5, "lag {lag}, frame {frame}: {error}");
                }
            }
        }
    }

    #[test]
    fn a_command_within_a_frame_corrects_for_the_rest_of_it() {
        let bench = Bench::small();
        for (lag, arrival, newer) in [(1.6, 1, 0.4), (2.25, 2, 0.75)] {
            let (law, mut controller) = start(&bench, &format!("filtered_modes = 2\nlag_frames = {lag}"));
            let impulse = irregular(32, 1);
            let slopes: Array1<f64> = impulse.iter().map(|&slope| f64::from(slope)).collect();
            let whole = law.command_matrix().dot(&slopes);
            for frame in 1..arrival + 4 {
                controller.step(if frame == 1 { &impulse } else { &[0.0; 32] }).unwrap();
                if frame < arrival {
                    assert!(controller.commands_nm().iter().all(|&command| command == 0.0), "lag {lag}, frame {frame}");
                    continue;
                }
                let share = if frame == arrival { newer } else { 1.0 };
                let expected: Vec<f32> = whole.iter().map(|c| (0.3 * share * c) as f32).collect();
                // As for a whole number of frames; the rounding of the share is another ε.
                let error = relative_difference(&expected, controller.commands_nm());
                assert!(error < 1e-5, "lag {lag}, frame {frame}: {error}");
            }
        }
    }

    #[test]
    fn fractional_lag_loop_diverges_beyond_its_largest_stable_gain() {
        // λ² − λ + g(0.6 + 0.4λ): |λ|² = 0.6 g once complex, so the limit is 1/0.6. The norm of 400
        // frames of λ changes by √0.96^400 = 3e-4 and √1.05^400 = 2e4.
        let bench = Bench::small();
        let turbulence: Array1<f64> = irregular(32, 3).iter().map(|&slope| f64::from(slope)).collect();
        for (gain, is_stable) in [(1.6, true), (1.75, false)] {
            let keys = format!("filtered_modes = 2\nlag_frames = 1.6\ngain = {gain}");
            let (law, _) = start(&bench, &keys);
            assert_eq!(law.stability().stable, is_stable);
            assert!((law.stability().largest_stable_gain - 1.0 / 0.6).abs() < 1e-9, "{:?}", law.stability());
            let history = run(&bench, &keys, &turbulence, 400);
            let change = |k: usize| relative_difference(&history[k], &history[k - 1]);
            assert_eq!(change(399) < 0.1 * change(10), is_stable, "{gain}: {} {}", change(10), change(399));
            assert!(is_stable || change(399) > 0.01);
            let size = |k: usize| history[k].iter().fold(0f32, |most, command| most.max(command.abs()));
            assert_eq!(size(399) > 100.0 * size(10), !is_stable, "{gain}: {} {}", size(10), size(399));
        }
    }

    #[test]
    fn a_leak_lets_commands_decay() {
        let bench = Bench::small();
        let (_, mut controller) = start(&bench, "filtered_modes = 2\nleak = 0.1");
        controller.step(&irregular(32, 2)).unwrap();
        let first = controller.commands_nm().to_vec();
        for _ in 0..10 {
            controller.step(&[0.0; 32]).unwrap();
        }
        let expected: Vec<f32> = first.iter().map(|command| command * 0.9f32.powi(10)).collect();
        // Ten products, each rounded to half of 1.2e-7.
        assert!(relative_difference(&expected, controller.commands_nm()) < 2e-6);
    }

    /// Runs the loop on a constant wavefront: s = turbulence − D c, with noise-free slopes.
    fn run(bench: &Bench, keys: &str, turbulence: &Array1<f64>, frames: usize) -> Vec<Vec<f32>> {
        let (_, mut controller) = start(bench, keys);
        let mut history = Vec::new();
        for _ in 0..frames {
            let commands: Array1<f64> = controller.commands_nm().iter().map(|&c| f64::from(c)).collect();
            let slopes = turbulence - bench.interaction.dot(&commands);
            controller.step(&slopes.iter().map(|&slope| slope as f32).collect::<Vec<_>>()).unwrap();
            history.push(controller.commands_nm().to_vec());
        }
        history
    }

    #[test]
    fn without_a_fill_all_laws_are_the_integrator() {
        // RD is the identity on the controlled modes, and the other modes stay 0: (1 − g)c + gR(s +
        // Dc) = c + gRs.
        let bench = Bench::keck();
        let turbulence: Array1<f64> = irregular(496, 3).iter().map(|&slope| 300.0 * f64::from(slope)).collect();
        let keys = |r#loop: &str, fill: &str| {
            format!("filtered_modes = 20\nleak = 0.02\nloop = {:?}\nfill = {fill:?}", r#loop)
        };
        for fill in ["none", "mask-interaction-matrix"] {
            let integrator = run(bench, &keys("closed", fill), &turbulence, 20);
            for r#loop in ["pseudo-open-loop", "full-turbulence-slopes"] {
                let other = run(bench, &keys(r#loop, fill), &turbulence, 20);
                for (frame, (one, other)) in integrator.iter().zip(&other).enumerate() {
                    // Single precision, with a condition number of up to a few hundred for the
                    // mask.
                    let error = relative_difference(one, other);
                    assert!(error < 1e-4, "{fill}, {}, frame {frame}: {error}", r#loop);
                }
            }
        }
    }

    #[test]
    fn the_folded_step_equals_the_law() {
        // All terms of each law in double precision, against the folded step; with a lag, a leak
        // and a fill.
        let bench = Bench::keck();
        let (gain, leak, lag) = (0.3, 0.05, 3);
        for (r#loop, newer) in [
            ("closed", 0.0),
            ("pseudo-open-loop", 0.0),
            ("full-turbulence-slopes", 0.0),
            ("closed", 0.25),
            ("pseudo-open-loop", 0.25),
            ("full-turbulence-slopes", 0.25),
        ] {
            let lag_frames = lag as f64 - newer;
            let keys = format!(
                "filtered_modes = 20\nleak = {leak}\nlag_frames = {lag_frames}\nfill = \"inpaint\"\nloop = {:?}",
                r#loop
            );
            let (law, mut controller) = start(bench, &keys);
            let fill = |slopes: &Array1<f64>| {
                let matrix = law.inpainting().unwrap().matrix();
                let halves = slopes.as_slice().unwrap().split_at(248);
                [halves.0, halves.1].iter().flat_map(|half| matrix.dot(&ndarray::aview1(half))).collect::<Array1<f64>>()
            };
            let command = law.command_matrix();
            // commands[k] is on the mirror in frame k.
            let mut commands = vec![Array1::<f64>::zeros(bench.interaction.ncols()); lag];
            for frame in 0..12 {
                let measured = irregular(496, frame);
                let slopes: Array1<f64> = measured.iter().map(|&slope| f64::from(slope)).collect();
                let present = |frame: usize| &commands[frame] * (1.0 - newer) + &commands[frame + 1] * newer;
                let last = &commands[frame + lag - 1];
                let own = bench.interaction.dot(&present(frame));
                let next = match r#loop {
                    "closed" => last * (1.0 - leak) + command.dot(&fill(&slopes)) * gain,
                    "pseudo-open-loop" => last * (1.0 - leak - gain) + command.dot(&fill(&(&slopes + &own))) * gain,
                    _ => last * (1.0 - leak) + command.dot(&(fill(&(&slopes + &own)) - &own)) * gain,
                };
                commands.push(next);
                controller.step(&measured).unwrap();
                let present = &commands[frame + 1] * (1.0 - newer) + &commands[frame + 2] * newer;
                let expected: Vec<f32> = present.iter().map(|&command| command as f32).collect();
                if frame + 1 >= lag {
                    // A dozen frames of sums of 800 terms in single precision.
                    let error = relative_difference(&expected, controller.commands_nm());
                    assert!(error < 1e-4, "{}, frame {frame}: {error}", r#loop);
                }
            }
        }
    }

    #[test]
    fn masked_slopes_do_not_reach_the_mirror_with_inpainting() {
        let bench = Bench::keck();
        let mut hidden = Array1::zeros(496);
        for (slope, masked) in hidden.iter_mut().zip(bench.mask.iter().chain(&bench.mask)) {
            *slope = if *masked { 100.0 } else { 0.0 };
        }
        let keys = "filtered_modes = 20\nfill = \"inpaint\"\nloop = \"pseudo-open-loop\"";
        let masked = run(bench, keys, &hidden, 30);
        assert!(masked.iter().flatten().all(|&command| command == 0.0));
        let open = run(bench, "filtered_modes = 20", &hidden, 30);
        assert!(open.iter().flatten().any(|&command| command.abs() > 10.0));
    }

    #[test]
    fn the_stroke_clips_and_does_not_wind_up() {
        let bench = Bench::small();
        let limit = 5.0;
        let plant = Plant { stroke_limit_nm: Some(limit), ..bench.plant() };
        let law = ControlLaw::new(&scene("filtered_modes = 2"), &plant).unwrap();
        let mut controller = law.start();
        let push: Vec<f32> = irregular(32, 4).iter().map(|slope| 1e4 * slope).collect();
        let back: Vec<f32> = push.iter().map(|slope| -slope).collect();
        for _ in 0..100 {
            controller.step(&push).unwrap();
            assert!(controller.commands_nm().iter().all(|command| command.abs() <= limit as f32));
        }
        let pushed = controller.commands_nm().to_vec();
        assert!(pushed.contains(&(limit as f32)));
        // One push in the opposite direction reverses every clipped command: the integrator has not
        // wound up.
        controller.step(&back).unwrap();
        let (before, after) = (pushed.iter(), controller.commands_nm().iter());
        assert!(before.zip(after).filter(|(before, _)| before.abs() == limit as f32).all(|(b, a)| a * b < 0.0));
    }

    #[test]
    fn invalid_input_is_refused_and_leaves_the_state_unchanged() {
        let bench = Bench::small();
        let (_, mut controller) = start(&bench, "filtered_modes = 2");
        assert!(matches!(controller.step(&[0.0; 31]), Err(Error::Shape(_))));
        controller.step(&irregular(32, 5)).unwrap();
        let before = controller.commands_nm().to_vec();
        assert!(controller.step(&[1.0; 33]).is_err());
        assert_eq!(controller.commands_nm(), before);

        let (short, mut gap) = (Array2::zeros((30, 25)), bench.interaction.clone());
        gap[[3, 4]] = f64::NAN;
        let wrong = Array2::zeros((24, 3));
        for plant in [
            Plant { interaction: &short, ..bench.plant() },
            Plant { interaction: &gap, ..bench.plant() },
            Plant { kl: Some(&wrong), ..bench.plant() },
            Plant { mask: &[true], ..bench.plant() },
            Plant { lenslets_across: 3, ..bench.plant() },
            Plant { stroke_limit_nm: Some(0.0), ..bench.plant() },
            Plant { stroke_limit_nm: Some(f64::NAN), ..bench.plant() },
            Plant { subapertures: &[], mask: &[], ..bench.plant() },
        ] {
            assert!(ControlLaw::new(&scene(""), &plant).is_err());
        }
        let changes: [fn(&mut ControlScene); 4] = [
            |scene| scene.gain = 0.0,
            |scene| scene.leak = 1.0,
            |scene| scene.lag_frames = 0.5,
            |scene| scene.condition_number = Some(0.5),
        ];
        for change in changes {
            let mut scene = scene("");
            change(&mut scene);
            assert!(ControlLaw::new(&scene, &bench.plant()).is_err());
        }
    }
}
