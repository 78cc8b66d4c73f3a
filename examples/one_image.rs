use cophase::{
    estimate::Estimator,
    imaging::{Chain, Precision},
    scene::Scene,
    source,
};
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let settings: Vec<(&str, &str)> = args[1..].iter().map(|a| a.split_once('=').unwrap()).collect();
    let scene = Scene::preset("keck-artificial").unwrap().with(&settings).unwrap();
    let t = std::time::Instant::now();
    let made = source::images(&scene).unwrap();
    println!(
        "images {:?} flux {:.4e} max {}",
        t.elapsed(),
        made.flux_e,
        made.images_e.iter().fold(0.0f64, |a, &b| a.max(b))
    );
    let t = std::time::Instant::now();
    let e = Estimator::new(&scene, false).unwrap();
    println!(
        "model {:?} {:?} {:?} modes {} dropped {:?}",
        t.elapsed(),
        e.model().optics.sampling(),
        e.model().preparation,
        e.model().optics.modes(),
        e.model().dropped
    );
    let mut chain = Chain::cpu(e.model().optics.clone(), Precision::F64);
    let bad = made.images_e.mapv(|_| false);
    let r = e.estimate(&mut chain, made.images_e.view(), bad.view(), None, None, &mut |_, _| {}).unwrap();
    let pupil = &e.model().telescope.pupil;
    let rms = |a: &ndarray::Array2<f64>, b: &ndarray::Array2<f64>| {
        let d = pupil.remove_piston_tip_tilt((a - b).view()).unwrap();
        pupil.rms(d.view()).unwrap()
    };
    println!(
        "phasing {:.4} ncpa {:.4} chi2 {:.3} evals {} status {:?} seconds {:.3}",
        rms(&r.phasing_nm, &made.truth.phasing_nm),
        rms(&r.ncpa_nm, &made.truth.ncpa_nm),
        r.reduced_chi2(),
        r.images[0].evaluations,
        r.images[0].status,
        r.seconds
    );
    let bound = e.bound(ndarray::ArrayView1::from(&r.combined.coefficients_nm), made.flux_e, 0.0).unwrap();
    let map_rms = |from: usize, to: usize| {
        let v = pupil;
        let mut s = 0.0;
        let m = e.model().basis.maps();
        for k in from..to {
            for l in from..to {
                let mut g = 0.0;
                for ((a, b), w) in
                    m.index_axis(ndarray::Axis(0), k).iter().zip(m.index_axis(ndarray::Axis(0), l)).zip(&v.amplitude)
                {
                    g += a * b * w;
                }
                s += g * bound[[k, l]];
            }
        }
        (s / v.weight_sum()).sqrt()
    };
    let n = e.model().segment_modes;
    println!("bound phasing {:.4} ncpa {:.4} (with tilt)", map_rms(0, n), map_rms(n, e.model().optics.modes()));
}
