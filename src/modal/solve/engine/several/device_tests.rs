//! Several devices: the same device opened twice, as two devices of one kind.

use crate::control::{Control, Stage};
use crate::device::Device;
use crate::device::tests::test_devices;
use crate::imaging::{Chain, DeviceGroup, Precision};
use crate::modal::{Cube, ModalFitter};
use crate::scene::Scene;
use crate::{Error, Result};
use ndarray::{Array2, Array3};
use std::sync::{Arc, Mutex};

const IMAGES: usize = 9;

struct Batch {
    fitter: ModalFitter,
    images_e: Array3<f64>,
}

impl Batch {
    /// Nine images, the fifth of which cannot be used.
    fn new() -> Self {
        let count = IMAGES.to_string();
        let settings =
            [("pupil.samples", "64"), ("image.crop_pixels", "64"), ("modes.ncpa", "none"), ("image.count", &count)];
        let scene = Scene::preset("keck-artificial").unwrap().with(&settings).unwrap();
        let mut images_e = crate::source::simulate(&scene).unwrap().remove(0).images_e;
        images_e.index_axis_mut(ndarray::Axis(0), 4).fill(5.0);
        Self { fitter: ModalFitter::new(&scene, true).unwrap(), images_e }
    }

    /// A chain on the device of this address, and the device.
    fn open(&self, address: &str) -> (Chain, Device) {
        let optics = self.fitter.model().optics.clone();
        let chain = Chain::open(optics, address.parse().unwrap(), Precision::F64, IMAGES).unwrap();
        let Chain::Device { chain: on_device, .. } = &chain else { panic!("a device that was named is opened") };
        let device = on_device.device().clone();
        (chain, device)
    }

    /// Coefficients of the images, nm, fitted on `chain`; the images that were counted grow to all.
    fn fit(&self, chain: &mut Chain) -> Result<Array2<f64>> {
        let bad = self.images_e.mapv(|_| false);
        let cube = Cube { images_e: self.images_e.view(), bad: bad.view(), read_noise_e: None };
        let counts = Arc::new(Mutex::new(vec![0]));
        let control = {
            let counts = counts.clone();
            Control::with_observer(move |progress| {
                if progress.stage == Stage::Fitting {
                    counts.lock().unwrap().push(progress.done);
                }
            })
        };
        let found = self.fitter.fit_each(chain, cube, &control)?;
        let counts = counts.lock().unwrap();
        assert!(counts.is_sorted(), "{counts:?}");
        Ok(found.coefficients_nm)
    }
}

fn several(chains: [Chain; 2]) -> Chain {
    let named = chains.map(|chain| (chain.device_name(), chain));
    Chain::Several(DeviceGroup::new(named.into(), &[]).unwrap())
}

fn bits(coefficients_nm: &Array2<f64>) -> Vec<u64> {
    coefficients_nm.iter().map(|nm| nm.to_bits()).collect()
}

#[test]
fn equal_devices_have_the_bits_of_one_and_replace_a_failed_one() {
    let batch = Batch::new();
    for info in test_devices().into_iter().filter(|info| info.supports(Precision::F64)) {
        let address = info.address();
        let alone_nm = batch.fit(&mut batch.open(&address).0).unwrap();
        assert!(alone_nm.row(4).iter().all(|nm| nm.is_nan()) && alone_nm.row(8).iter().all(|nm| nm.is_finite()));
        let ((one, _), (other, second)) = (batch.open(&address), batch.open(&address));
        let mut group = several([one, other]);
        assert_eq!(bits(&batch.fit(&mut group).unwrap()), bits(&alone_nm), "{address}");
        assert_eq!(group.failure(), None);
        // The second device is lost in its first piece: the first one fits all images, in their
        // places.
        second.fault().arm(second.fault().commands() + 20, u64::MAX);
        assert_eq!(bits(&batch.fit(&mut group).unwrap()), bits(&alone_nm), "{address}");
        let failure = group.failure().expect("a lost device gives a warning");
        assert!(failure.starts_with(&address) && failure.contains("have taken its images"), "{failure}");
        assert_eq!(group.device_name().matches(&address).count(), 1, "{}", group.device_name());
        // All are lost: an error, and not fewer images.
        let devices = [batch.open(&address), batch.open(&address)];
        devices.iter().for_each(|(_, device)| device.fault().arm(device.fault().commands() + 20, u64::MAX));
        let mut group = several(devices.map(|(chain, _)| chain));
        let error = batch.fit(&mut group).unwrap_err();
        assert!(matches!(&error, Error::Device(reason) if reason.starts_with("all devices have failed")), "{error}");
    }
}
