//! A device that was taken because it was there, and the CPU that takes its place where it fails.

use super::chain::Chain;
use super::detector::{Evaluation, Exposure};
use super::optics::Optics;
use crate::{Error, Result};
use ndarray::ArrayView2;
use std::sync::Arc;

/// A chain on a device that may be lost in the midst of a batch: short of memory, reset by its driver, unplugged. Nothing is
/// lost with it, for the images are kept here too (16 bytes a pixel), and what failed is done again on the CPU in the same
/// precision. It stays there: a device that failed once is not trusted with the next image.
pub struct Fallback {
    chain: Box<Chain>,
    optics: Arc<Optics>,
    exposures: Vec<Exposure>,
    failure: Option<String>,
}

impl Fallback {
    /// Guards `device`, a chain for `optics`.
    pub(crate) fn new(device: Chain, optics: Arc<Optics>) -> Self {
        Self { chain: Box::new(device), optics, exposures: Vec::new(), failure: None }
    }

    /// What failed, and that the CPU took over, as a sentence.
    pub fn failure(&self) -> Option<&str> {
        self.failure.as_deref()
    }

    /// The chain that computes now.
    pub(super) fn chain(&self) -> &Chain {
        &self.chain
    }

    pub(super) fn chain_mut(&mut self) -> &mut Chain {
        &mut self.chain
    }

    pub(super) fn load(&mut self, exposures: &[Exposure]) -> Result<()> {
        // None are loaded until all are.
        self.exposures.clear();
        self.guarded(|chain| chain.load(exposures))?;
        self.exposures.extend_from_slice(exposures);
        Ok(())
    }

    pub(super) fn replace_all(&mut self, exposures: &[(usize, &Exposure)]) -> Result<()> {
        self.guarded(|chain| chain.replace_all(exposures))?;
        exposures.iter().for_each(|&(image, exposure)| self.exposures[image] = exposure.clone());
        Ok(())
    }

    pub(super) fn evaluate(&mut self, images: &[usize], coefficients_nm: ArrayView2<f64>) -> Result<Vec<Evaluation>> {
        self.guarded(|chain| chain.evaluate(images, coefficients_nm))
    }

    pub(super) fn evaluate_free(
        &mut self,
        images: &[usize],
        coefficients_nm: ArrayView2<f64>,
        free: &[f64],
        slopes: &mut [f64],
    ) -> Result<Vec<Evaluation>> {
        self.guarded(|chain| chain.evaluate_free(images, coefficients_nm, free, slopes))
    }

    /// Makes a call, and makes it again on the CPU where the device fails.
    fn guarded<R>(&mut self, mut call: impl FnMut(&mut Chain) -> Result<R>) -> Result<R> {
        match call(&mut self.chain) {
            Err(Error::Device(reason)) if self.failure.is_none() => {
                let mut cpu = Chain::cpu(self.optics.clone(), self.chain.precision());
                cpu.load(&self.exposures)?;
                let device = self.chain.device_name();
                self.failure = Some(format!("{device} failed, and the CPU has taken its place: {reason}"));
                *self.chain = cpu;
                call(&mut self.chain)
            }
            other => other,
        }
    }
}

#[cfg(all(test, feature = "opencl", debug_assertions))]
mod tests {
    use super::super::agreement::{allowed, apart, case, free_phase, slopes_apart};
    use super::super::chain::layout;
    use super::super::gpu::{GpuChain, GpuLayout};
    use super::*;
    use crate::device::tests::test_devices;
    use crate::device::{Device, Precision};
    use crate::imaging::CpuChain;

    /// Each command of a load, an evaluation, a replacement and another evaluation fails in turn, once or for good: the
    /// answers are those of the CPU all the same.
    #[test]
    fn no_command_that_fails_changes_an_answer() {
        for info in test_devices() {
            let case = case(1);
            let mut judge = CpuChain::<f64>::new(case.optics.clone());
            judge.load(&case.exposures).unwrap();
            let first = judge.evaluate(&case.active, case.coefficients_nm.view()).unwrap();
            let other = Exposure {
                data_e: case.exposures[0].data_e.iter().map(|e| 2.0 * e).collect(),
                ..case.exposures[0].clone()
            };
            judge.replace(0, &other).unwrap();
            let second = judge.evaluate(&case.active, case.coefficients_nm.view()).unwrap();
            let free = free_phase(&case);
            let mut wanted_slopes = vec![f64::NAN; free.len()];
            let third =
                judge.evaluate_free_all(&case.active, case.coefficients_nm.view(), &free, &mut wanted_slopes).unwrap();
            let layout = GpuLayout { free_phase: true, ..layout(&case.optics) };
            let run = |failing: Option<(u64, u64)>| {
                let device = Device::open(&info, false).unwrap();
                let made = GpuChain::new(&device, Precision::F64, &layout, case.exposures.len()).unwrap();
                let before = device.fault().commands();
                if let Some((from, end)) = failing {
                    device.fault().arm(before + from, before.saturating_add(end));
                }
                let (optics, precision, name) = (case.optics.clone(), Precision::F64, info.address());
                let chain = Chain::Device { chain: Box::new(made), optics: optics.clone(), precision, name };
                let mut chain = Chain::Auto(Fallback::new(chain, optics));
                chain.load(&case.exposures).unwrap();
                let found = chain.evaluate(&case.active, case.coefficients_nm.view()).unwrap();
                assert!(apart(&found, &first) < allowed(precision), "{failing:?}");
                chain.replace(0, &other).unwrap();
                let found = chain.evaluate(&case.active, case.coefficients_nm.view()).unwrap();
                assert!(apart(&found, &second) < allowed(precision), "{failing:?}");
                let mut slopes = vec![f64::NAN; free.len()];
                let found = chain.evaluate_free(&case.active, case.coefficients_nm.view(), &free, &mut slopes).unwrap();
                let distance = apart(&found, &third).max(slopes_apart(&slopes, &wanted_slopes, case.active.len()));
                assert!(distance < allowed(precision), "{failing:?}");
                assert_eq!(chain.failure().is_some(), failing.is_some(), "{failing:?}");
                assert_eq!(chain.device_name() == "cpu", failing.is_some());
                device.fault().commands() - before
            };
            if !info.supports(Precision::F64) {
                continue;
            }
            let commands = run(None);
            assert!(commands > 10, "{commands} commands");
            for k in 1..=commands {
                run(Some((k, k + 1)));
                run(Some((k, u64::MAX)));
            }
        }
    }

    /// A device that was named is not replaced: its failure is the caller's, and the next call finds it as it is by then.
    #[test]
    fn a_device_that_was_named_fails_with_a_status_and_can_be_used_again() {
        for info in test_devices().into_iter().filter(|info| info.supports(Precision::F64)) {
            let case = case(1);
            let device = Device::open(&info, false).unwrap();
            let made = GpuChain::new(&device, Precision::F64, &layout(&case.optics), case.exposures.len()).unwrap();
            let (optics, precision, name) = (case.optics.clone(), Precision::F64, info.address());
            let mut chain = Chain::Device { chain: Box::new(made), optics, precision, name };
            chain.load(&case.exposures).unwrap();
            let wanted = chain.evaluate(&case.active, case.coefficients_nm.view()).unwrap();
            for k in 1..4 {
                device.fault().arm(device.fault().commands() + k, device.fault().commands() + k + 1);
                let error = chain.evaluate(&case.active, case.coefficients_nm.view()).unwrap_err();
                assert!(matches!(error, Error::Device(_)) && error.to_string().lines().count() == 1, "{error}");
                let again = chain.evaluate(&case.active, case.coefficients_nm.view()).unwrap();
                assert!(apart(&again, &wanted) < allowed(precision));
            }
        }
    }
}
