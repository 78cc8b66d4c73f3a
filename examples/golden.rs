use cophase::{
    estimate::Estimator,
    imaging::{Chain, Precision},
    io,
    scene::Scene,
};
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let settings: Vec<(&str, &str)> = args[1..].iter().map(|a| a.split_once('=').unwrap()).collect();
    let scene = Scene::from_file("tests/golden/scene.toml").unwrap().with(&settings).unwrap();
    let e = Estimator::new(&scene, false).unwrap();
    for f in ["inspan", "zern"] {
        let f = format!("tests/golden/{f}.fits.gz");
        let im = io::read_images(&f, None).unwrap();
        let mut chain = Chain::cpu(e.model().optics.clone(), Precision::F64);
        let r = e.estimate(&mut chain, im.data.view(), im.bad.view(), None, None, &mut |_, _| {}).unwrap();
        let pupil = &e.model().telescope.pupil;
        let rms = |a: &ndarray::Array2<f64>, b: &str| {
            let d = pupil.remove_piston_tip_tilt((a - &io::read_map(&f, Some(b)).unwrap()).view()).unwrap();
            pupil.rms(d.view()).unwrap()
        };
        println!(
            "{f} modes {} phasing {:.4} ncpa {:.4} chi2 {:.4} evals {} status {:?} seconds {:.3}",
            e.model().optics.modes(),
            rms(&r.phasing_nm, "TRUTH_PHASING"),
            rms(&r.ncpa_nm, "TRUTH_NCPA"),
            r.reduced_chi2(),
            r.images[0].evaluations,
            r.images[0].status,
            r.seconds
        );
    }
}
