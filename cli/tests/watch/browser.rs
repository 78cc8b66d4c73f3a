//! The page in a headless Chromium (Debian's package), spoken to through its pipe for debuggers:
//! NUL-terminated JSON on descriptors 3 and 4.

use super::page::Site;
use super::*;
use serde_json::{Value, json};
use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::os::fd::{FromRawFd, IntoRawFd, OwnedFd};
use std::os::unix::process::CommandExt;
use std::process::Command;

/// The browser with one page.
struct Browser {
    child: Child,
    to: File,
    from: BufReader<File>,
    session: Option<String>,
    next: u64,
    /// Messages of the page that are no answers to requests.
    notices: Vec<Value>,
}

fn pipe() -> (OwnedFd, OwnedFd) {
    let mut ends = [0; 2];
    // SAFETY: the call writes two descriptors into a live local, which this function owns.
    unsafe {
        assert_eq!(libc::pipe2(ends.as_mut_ptr(), libc::O_CLOEXEC), 0);
        (OwnedFd::from_raw_fd(ends[0]), OwnedFd::from_raw_fd(ends[1]))
    }
}

impl Browser {
    /// `None`, with a line that says so, where there is no Chromium; an error with
    /// COPHASE_REQUIRE_CHROMIUM=1.
    fn start(desk: &Desk) -> Option<Self> {
        let is_there = Command::new("chromium").arg("--version").output().is_ok_and(|output| output.status.success());
        if !is_there {
            assert!(std::env::var("COPHASE_REQUIRE_CHROMIUM").as_deref() != Ok("1"), "there is no chromium");
            println!("skipped: no chromium was found");
            return None;
        }
        let ((theirs, to), (from, answers)) = (pipe(), pipe());
        let (theirs, answers) = (theirs.into_raw_fd(), answers.into_raw_fd());
        let mut command = Command::new("chromium");
        // Without a sandbox, which containers do not allow: the page is ours. No name leads
        // anywhere but to this machine.
        command.args([
            "--headless=new",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-dev-shm-usage",
            "--no-first-run",
            "--remote-debugging-pipe",
            "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
        ]);
        command.arg(format!("--user-data-dir={}", desk.path("browser").display()));
        command.env("HOME", desk.path(".")).stdout(Stdio::null()).stderr(Stdio::null());
        // SAFETY: plain system calls between fork and exec. The descriptors are above 4, or stay
        // where they belong.
        unsafe {
            command.pre_exec(move || {
                // Out of the way first: one may be where the other goes.
                let (read, write) = (libc::fcntl(theirs, libc::F_DUPFD, 10), libc::fcntl(answers, libc::F_DUPFD, 10));
                (libc::dup2(read, 3) == 3 && libc::dup2(write, 4) == 4)
                    .then_some(())
                    .ok_or_else(std::io::Error::last_os_error)
            });
        }
        let child = command.spawn().unwrap();
        // SAFETY: the ends of the child, which this process does not use.
        unsafe {
            libc::close(theirs);
            libc::close(answers);
        }
        let (to, from) = (File::from(to), BufReader::new(File::from(from)));
        let mut browser = Self { child, to, from, session: None, next: 1, notices: Vec::new() };
        let target = browser.call("Target.createTarget", json!({ "url": "about:blank" }));
        let attached =
            browser.call("Target.attachToTarget", json!({ "targetId": target["targetId"], "flatten": true }));
        browser.session = attached["sessionId"].as_str().map(str::to_owned);
        for domain in ["Runtime", "Log", "Network", "Page"] {
            browser.call(&format!("{domain}.enable"), json!({}));
        }
        Some(browser)
    }

    fn call(&mut self, method: &str, params: Value) -> Value {
        let id = self.next;
        self.next += 1;
        let mut message = json!({ "id": id, "method": method, "params": params });
        if let Some(session) = &self.session {
            message["sessionId"] = json!(session);
        }
        self.to.write_all(format!("{message}\0").as_bytes()).unwrap();
        loop {
            let mut bytes = Vec::new();
            assert!(self.from.read_until(0, &mut bytes).unwrap() > 0, "chromium ended");
            let answer: Value = serde_json::from_slice(&bytes[..bytes.len() - 1]).unwrap();
            if answer["id"] == json!(id) {
                assert!(answer.get("error").is_none(), "{method}: {answer}");
                return answer["result"].clone();
            }
            self.notices.push(answer);
        }
    }

    /// The value of an expression in the page.
    fn value(&mut self, expression: &str) -> Value {
        let answer = self.call("Runtime.evaluate", json!({ "expression": expression, "returnByValue": true }));
        assert!(answer.get("exceptionDetails").is_none(), "{expression}: {answer}");
        answer["result"]["value"].clone()
    }

    fn wait_for(&mut self, expression: &str) {
        wait_until(expression, || self.value(expression) == json!(true));
    }

    /// Width and height of the window, and whether it is dark.
    fn look(&mut self, width: u32, height: u32, is_dark: bool) {
        let size = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false });
        self.call("Emulation.setDeviceMetricsOverride", size);
        let scheme = if is_dark { "dark" } else { "light" };
        let feature = json!({ "features": [{ "name": "prefers-color-scheme", "value": scheme }] });
        self.call("Emulation.setEmulatedMedia", feature);
    }

    fn picture(&mut self) -> Vec<u8> {
        let answer = self.call("Page.captureScreenshot", json!({ "format": "png" }));
        base64(answer["data"].as_str().unwrap())
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn base64(text: &str) -> Vec<u8> {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let letters = text.bytes().filter(|byte| *byte != b'=');
    let values: Vec<u32> =
        letters.map(|byte| LETTERS.iter().position(|letter| *letter == byte).unwrap() as u32).collect();
    let whole = |chunk: &[u32]| {
        let bits = chunk.iter().fold(0, |bits, value| bits << 6 | value) << (6 * (4 - chunk.len()));
        bits.to_be_bytes()[1..chunk.len()].to_vec()
    };
    values.chunks(4).flat_map(whole).collect()
}

/// `COPHASE_BLESS=1` writes the picture of the page to `docs/watch.png`.
#[test]
fn the_page_loads_without_an_error_and_shows_each_frame() {
    let desk = super::night::desk_of_a_night();
    let held: Vec<String> = (16..20).map(|number| format!("{number:03}.fits")).collect();
    std::fs::create_dir(desk.path("later")).unwrap();
    for name in &held {
        std::fs::rename(desk.path(&format!("frames/{name}")), desk.path(&format!("later/{name}"))).unwrap();
    }
    std::fs::write(desk.path("frames/cut.fits"), "SIMPLE  = no FITS file").unwrap();
    let Some(mut browser) = Browser::start(&desk) else { return };
    let site = Site::start(&desk, &[]);
    wait_for_rows(&desk, 17);
    let address = format!("http://{}/", site.host());
    browser.look(1200, 2080, false);
    browser.call("Page.navigate", json!({ "url": address }));
    browser.wait_for("document.body?.dataset.frames === '16'");
    // A frame that arrives is shown without being asked for.
    for name in &held {
        std::fs::rename(desk.path(&format!("later/{name}")), desk.path(&format!("frames/{name}"))).unwrap();
    }
    browser.wait_for("document.body.dataset.frames === '20'");
    assert_eq!(browser.value("document.querySelectorAll('#mirror .segment').length"), json!(7));
    browser.value("document.querySelector('[data-segment=\"2\"]').dispatchEvent(new MouseEvent('click')); true");
    browser.wait_for("document.querySelectorAll('#segment .bar').length === 20");
    browser.wait_for("document.querySelectorAll('#segment .band').length === 1");
    assert!(browser.value("document.querySelectorAll('#events li.alarm').length").as_i64().unwrap() > 0);
    assert!(browser.value("document.getElementById('refused').textContent").as_str().unwrap().contains("cut.fits"));
    for canvas in ["ncpa", "image", "residual"] {
        assert!(
            browser.value(&format!("document.getElementById('{canvas}').width")).as_i64().unwrap() > 10,
            "{canvas}"
        );
    }
    let picture = browser.picture();
    assert!(picture.starts_with(b"\x89PNG"), "no picture");
    if std::env::var("COPHASE_BLESS").as_deref() == Ok("1") {
        std::fs::write(concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/watch.png"), &picture).unwrap();
    }
    // On a phone nothing is wider than the window, and text has the size of text; dark has other
    // colours.
    let ground = "getComputedStyle(document.body).backgroundColor";
    let light = browser.value(ground);
    browser.look(390, 844, true);
    browser.wait_for("document.documentElement.scrollWidth <= 390");
    assert_ne!(browser.value(ground), light);
    let small = "[...document.querySelectorAll('p, li, dd, dt, h2, h3, figcaption')].some((text) => parseFloat(getComputedStyle(text).fontSize) < 12)";
    assert_eq!(browser.value(small), json!(false));
    if let Some(folder) = std::env::var_os("COPHASE_PICTURES") {
        std::fs::write(Path::new(&folder).join("phone.png"), browser.picture()).unwrap();
    }
    let errors: Vec<&Value> = browser
        .notices
        .iter()
        .filter(|notice| {
            let (method, params) = (notice["method"].as_str().unwrap_or_default(), &notice["params"]);
            method == "Runtime.exceptionThrown"
                || method == "Network.loadingFailed" && params["canceled"] != json!(true)
                || method == "Runtime.consoleAPICalled" && params["type"] == "error"
                || method == "Log.entryAdded" && params["entry"]["level"] == "error"
        })
        .collect();
    assert!(errors.is_empty(), "{errors:?}");
    let asked = browser.notices.iter().filter(|notice| notice["method"] == "Network.requestWillBeSent");
    let asked: Vec<&str> = asked.map(|notice| notice["params"]["request"]["url"].as_str().unwrap()).collect();
    assert!(asked.len() > 8 && asked.iter().all(|url| url.starts_with(&address)), "{asked:?}");
}
