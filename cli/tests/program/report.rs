//! Reports for people: one HTML file of an estimate, and of a night.

use crate::Desk;
use cophase::io::FitsReader;

/// What a browser could ask for: none of it may be elsewhere.
fn is_self_contained(html: &str) -> bool {
    let attributes = ["src=", "href=", "url(", "@import", "<script", "<link", "<iframe"];
    let places = attributes.iter().flat_map(|what| html.match_indices(what).map(|(at, _)| &html[at..]));
    places.into_iter().all(|rest| rest.starts_with("src=\"data:image/png;base64,"))
}

/// Cells of the rows of the table below the heading `heading`.
fn table(html: &str, heading: &str) -> Vec<Vec<String>> {
    let section = html.split(&format!("<h2>{heading}</h2>")).nth(1).unwrap().split("</section>").next().unwrap();
    let rows = section.split("<tr>").skip(2);
    let cell = |cell: &str| cell.split_once('>').unwrap().1.split("</td>").next().unwrap().to_owned();
    rows.map(|row| row.split("<td").skip(1).map(cell).collect()).collect()
}

#[test]
fn a_report_of_an_estimate_is_one_file_with_its_numbers() {
    let desk = Desk::with_images(&[]);
    std::fs::rename(desk.path("images.fits"), desk.path("a<b>&.fits")).unwrap();
    let arguments = ["estimate", "a<b>&.fits", "-o", "est.fits", "--report", "est.html"];
    desk.succeeds(&arguments);
    let html = std::fs::read_to_string(desk.path("est.html")).unwrap();
    assert!(is_self_contained(&html));
    assert!(html.contains("Estimate from a&lt;b&gt;&amp;.fits") && !html.contains("<b>"));
    assert!(html.contains("prefers-color-scheme: dark") && html.contains("width=device-width"));
    // Warnings and status stand before the numbers, remarks of this scene with them.
    let place = |text: &str| html.find(text).unwrap_or_else(|| panic!("{text}"));
    assert!(place("<h2>Status</h2>") < place("<h2>Result</h2>") && place("<h2>Result</h2>") < place("<h2>Mirror</h2>"));
    assert_eq!(html.matches("<polygon").count(), 7);
    assert_eq!(html.matches("<img").count(), 9);
    assert!(html.contains("estimate &#39;a&lt;b&gt;&amp;.fits&#39; -o est.fits --report est.html"));
    assert!(html.contains("diversity_focus_waves_rms") && html.contains(env!("CARGO_PKG_VERSION")));
    // Numbers are those of the FITS file, to the picometre that is printed.
    let mut file = FitsReader::open(desk.path("est.fits")).unwrap();
    let names = file.text_column("MODES", "NAME").unwrap();
    let [values, errors] = ["ESTIMATE_NM", "SIGMA_NM"].map(|column| file.f64_column("MODES", column).unwrap());
    let rows = table(&html, "Modes");
    assert_eq!(rows.len(), names.len());
    for (row, ((name, value), error)) in rows.iter().zip(names.iter().zip(&values).zip(&errors)) {
        assert_eq!(&row[0], name);
        for (cell, number) in [(&row[1], value), (&row[2], error)] {
            assert!((cell.parse::<f64>().unwrap() - number).abs() <= 0.000_501, "{name}: {cell} {number}");
        }
    }
    let segments = table(&html, "Segments");
    assert_eq!((segments.len(), segments[3][2].as_str()), (7, rows[3][1].as_str()));
    // Another name is refused before the work; nothing is written where the estimate fails.
    desk.refuses(&["estimate", "a<b>&.fits", "-o", "e.fits", "--report", "est.txt"], &["est.txt", ".html"]);
    desk.refuses(&["estimate", "a<b>&.fits", "-o", "e.html", "--report", "e.html"], &["e.html", "--report"]);
}

#[test]
fn a_report_has_the_warnings_first() {
    let desk = Desk::with_images(&[]);
    let wrong = ["estimate", "images.fits", "-o", "est.fits", "--report", "est.html", "--trust", "scene"];
    let scale = ["--set", "image.samples_per_lambda_over_d=2.06", "--set", "estimate.model=scene"];
    let done = desk.succeeds(&[&wrong[..], &scale].concat());
    let html = std::fs::read_to_string(desk.path("est.html")).unwrap();
    let status = html.split("<h2>Result</h2>").next().unwrap();
    assert!(!done.err.is_empty() && status.contains("class=\"alarm\"") && status.contains("misfit"), "{}", done.err);
}
