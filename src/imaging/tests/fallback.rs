//! A device that fails during a batch, and the CPU chain that replaces it.

use crate::Error;
use crate::device::tests::test_devices;
use crate::device::{Device, Precision};
use crate::imaging::agreement::{allowed, case, free_phase, largest_difference, largest_gradient_difference};
use crate::imaging::chain::{Chain, Fallback, layout};
use crate::imaging::gpu::{GpuChain, GpuLayout};
use crate::imaging::{CpuChain, Exposure};

/// Each command of a load, an evaluation, a replacement and another evaluation fails in turn, once
/// or permanently: the results are those of the CPU. Every seventh command, unless
/// `scripts/test --all` runs the test.
#[test]
#[ignore = "merge: 18 s"]
fn no_failing_command_changes_a_result() {
    for info in test_devices() {
        let case = case(1);
        let mut reference = CpuChain::<f64>::new(case.optics.clone());
        reference.load(&case.exposures).unwrap();
        let first = reference.evaluate(&case.active, case.coefficients_nm.view()).unwrap();
        let other = Exposure {
            data_e: case.exposures[0].data_e.iter().map(|e| 2.0 * e).collect(),
            ..case.exposures[0].clone()
        };
        reference.replace(0, &other).unwrap();
        let second = reference.evaluate(&case.active, case.coefficients_nm.view()).unwrap();
        let free = free_phase(&case);
        let mut wanted_slopes = vec![f64::NAN; free.len()];
        let third =
            reference.evaluate_free_all(&case.active, case.coefficients_nm.view(), &free, &mut wanted_slopes).unwrap();
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
            assert!(largest_difference(&found, &first) < allowed(precision), "{failing:?}");
            chain.replace(0, &other).unwrap();
            let found = chain.evaluate(&case.active, case.coefficients_nm.view()).unwrap();
            assert!(largest_difference(&found, &second) < allowed(precision), "{failing:?}");
            let mut slopes = vec![f64::NAN; free.len()];
            let found = chain.evaluate_free(&case.active, case.coefficients_nm.view(), &free, &mut slopes).unwrap();
            let distance = largest_difference(&found, &third).max(largest_gradient_difference(
                &slopes,
                &wanted_slopes,
                case.active.len(),
            ));
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
        let step = if std::env::var_os("COPHASE_LONG_TESTS").is_some() { 1 } else { 7 };
        for k in (1..=commands).step_by(step) {
            run(Some((k, k + 1)));
            run(Some((k, u64::MAX)));
        }
    }
}

/// A device selected by name is not replaced: its failure is returned, and the next call uses it
/// again.
#[test]
fn named_device_fails_with_a_status_and_remains_usable() {
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
            assert!(largest_difference(&again, &wanted) < allowed(precision));
        }
    }
}
