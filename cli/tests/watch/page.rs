//! The page: what it answers, and whom it refuses. Requests are bytes on a socket, as an attacker
//! writes them.

use super::*;
use serde_json::Value;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};

/// A watch with a page on a port of the system's choice.
pub struct Site {
    pub running: Running,
    address: SocketAddr,
}

/// Status, headers in lower case, and body of an answer.
struct Answer {
    status: u16,
    head: String,
    body: String,
}

impl Site {
    pub fn start(desk: &Desk, options: &[&str]) -> Self {
        Self::start_as(desk, &WATCH, options)
    }

    pub fn start_as(desk: &Desk, words: &[&str], options: &[&str]) -> Self {
        let running = Running::start_as(desk, &[words, &["--port", "0"], options].concat());
        let mut found = None;
        wait_until("the address of the page", || {
            let text = std::fs::read_to_string(desk.path("stdout.txt")).unwrap();
            let line = text.lines().find_map(|line| line.strip_prefix("page: http://").map(str::to_owned));
            found = line.and_then(|line| line.trim_end_matches('/').parse().ok());
            found.is_some()
        });
        Self { running, address: found.unwrap() }
    }

    pub fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(("127.0.0.1", self.address.port())).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        stream
    }

    /// Sends `head` (lines without the last empty one) and reads until the server closes.
    fn send(&self, head: &str) -> Answer {
        let mut stream = self.connect();
        let text = format!("{}\r\nConnection: close\r\n\r\n", head.trim().replace('\n', "\r\n"));
        // A server that refuses early closes while the rest is written.
        let _ = stream.write_all(text.as_bytes());
        let mut bytes = Vec::new();
        let _ = stream.read_to_end(&mut bytes);
        let text = String::from_utf8_lossy(&bytes).into_owned();
        let (head, body) = text.split_once("\r\n\r\n").unwrap_or((&text, ""));
        let status = head.split(' ').nth(1).and_then(|word| word.parse().ok()).unwrap_or(0);
        // Pages come whole here; JSON may come in chunks, of which there is one.
        Answer { status, head: head.to_ascii_lowercase(), body: body.to_owned() }
    }

    pub fn host(&self) -> String {
        format!("127.0.0.1:{}", self.address.port())
    }

    fn get(&self, path: &str) -> Answer {
        self.send(&format!("GET {path} HTTP/1.1\nHost: {}", self.host()))
    }

    fn json(&self, path: &str) -> Value {
        let answer = self.get(path);
        assert_eq!(answer.status, 200, "{path}: {}", answer.body);
        serde_json::from_str(&answer.body).unwrap_or_else(|error| panic!("{path}: {error}: {}", answer.body))
    }
}

#[test]
fn the_page_and_its_json_show_the_frames() {
    let desk = desk_with_frames(3);
    put(&desk, 0);
    let mut site = Site::start(&desk, &[]);
    wait_for_rows(&desk, 1);
    // Server-sent events: the version now, and one after each frame.
    let mut stream = site.connect();
    write!(stream, "GET /api/changes HTTP/1.1\r\nHost: {}\r\n\r\n", site.host()).unwrap();
    let mut said = String::new();
    let mut read_until = |stream: &mut TcpStream, count: usize| {
        while said.matches("event: changed").count() < count {
            let mut bytes = [0; 1024];
            let got = stream.read(&mut bytes).unwrap();
            assert!(got > 0, "{said}");
            said.push_str(&String::from_utf8_lossy(&bytes[..got]));
        }
    };
    read_until(&mut stream, 1);
    (1..3).for_each(|number| put(&desk, number));
    std::fs::write(desk.path("frames/text.fits"), "no FITS file\n").unwrap();
    wait_for_rows(&desk, 4);
    read_until(&mut stream, 2);
    let status = site.json("/api/status");
    assert_eq!(
        (status["counts"]["done"].as_i64(), status["counts"]["refused"].as_i64()),
        (Some(3), Some(1)),
        "{status}"
    );
    assert_eq!(status["policy"], "realtime");
    let mirror = site.json("/api/mirror");
    let segments = mirror["segments"].as_array().unwrap();
    assert_eq!(segments.len(), 7);
    let known =
        segments.iter().filter(|segment| segment["tracked_nm"].is_f64() && segment["tracked_sigma_nm"].is_f64());
    assert!(known.count() >= 6, "{mirror}");
    let history = site.json("/api/segments/1?limit=2");
    assert_eq!(history["history"].as_array().unwrap().len(), 2);
    assert_eq!(site.json("/api/trend")["time_s"].as_array().unwrap().len(), 3);
    let refused = &site.json("/api/refused")["refused"][0];
    assert!(refused["name"].as_str().unwrap().contains("text.fits"), "{refused}");
    assert!(!refused["reason"].as_str().unwrap().contains("text.fits"), "{refused}");
    assert!(!site.json("/api/ncpa")["nm"].as_array().unwrap().is_empty());
    assert!(!site.json("/api/image")["residual_sigma"].as_array().unwrap().is_empty());
    assert!(site.json("/api/events")["events"].as_array().unwrap().is_empty());
    assert!(site.json("/api/corrections")["corrections"].as_array().unwrap().is_empty());
    let frames = site.json("/api/frames?after=2&limit=1");
    assert_eq!(frames["frames"][0]["id"], 3);
    assert!(site.json("/api/frames/1")["coefficients_nm"].as_array().unwrap().len() > 14);
    // Every address that the page names is one that the server has, and none is elsewhere.
    let page = site.get("/");
    for address in page.body.split(['"', '\'']).filter(|word| word.starts_with('/') && word.len() > 1) {
        assert_eq!(site.get(address).status, 200, "{address}");
    }
    for file in ["/", "/page.css", "/page.js", "/charts.js"] {
        let body = site.get(file).body.replace("http://www.w3.org/2000/svg", "");
        assert!(!body.contains("http:") && !body.contains("https:") && !body.contains("//cdn"), "{file}");
    }
    // A browser that goes away in the midst is no fault.
    drop(stream);
    let mut gone = site.connect();
    write!(gone, "GET /api/trend HTTP/1.1\r\nHost: {}\r\n\r\n", site.host()).unwrap();
    drop(gone);
    std::fs::copy(made(&desk, 0), desk.path("frames/again.fits")).unwrap();
    assert_eq!(site.get("/api/status").status, 200);
    assert_eq!(site.running.stop(), Some(0));
}

#[test]
fn requests_of_other_sites_are_refused() {
    let desk = desk_with_frames(1);
    let site = Site::start(&desk, &[]);
    let (host, port) = (site.host(), site.address.port());
    let with = |line: &str| site.send(&format!("GET /api/status HTTP/1.1\nHost: {host}\n{line}"));
    let page = site.get("/");
    assert_eq!(page.status, 200);
    for header in [
        "content-security-policy: default-src 'none'; script-src 'self'",
        "frame-ancestors 'none'",
        "x-content-type-options: nosniff",
        "x-frame-options: deny",
        "referrer-policy: no-referrer",
        "cross-origin-resource-policy: same-origin",
        "cache-control: no-store",
    ] {
        assert!(page.head.contains(header), "{header}: {}", page.head);
    }
    assert!(!page.head.contains("access-control"), "{}", page.head);
    // DNS rebinding: a name of the attacker's that points here.
    for host in
        [format!("evil.example:{port}"), "127.0.0.1".into(), format!("127.0.0.1.evil.example:{port}"), String::new()]
    {
        assert_eq!(site.send(&format!("GET / HTTP/1.1\nHost: {host}")).status, 421, "{host}");
    }
    assert_eq!(site.send(&format!("GET / HTTP/1.1\nHost: {host}\nHost: evil.example")).status, 421);
    assert!([400, 421].contains(&site.send("GET / HTTP/1.1").status));
    assert_eq!(with(&format!("Origin: http://{host}")).status, 200);
    for line in [
        "Origin: http://evil.example".to_string(),
        "Origin: null".into(),
        format!("Origin: https://{host}"),
        format!("Origin: http://127.0.0.1:{}", port.wrapping_add(1)),
        "Sec-Fetch-Site: cross-site".into(),
        "Sec-Fetch-Site: same-site".into(),
        "Sec-Fetch-Site: cross-site\nSec-Fetch-Mode: navigate\nSec-Fetch-Dest: document".into(),
    ] {
        let answer = with(&line);
        assert_eq!(answer.status, 403, "{line}");
        assert!(!answer.body.contains("counts") && !answer.head.contains("access-control"), "{line}");
    }
    assert_eq!(with("Sec-Fetch-Site: same-origin").status, 200);
    // A link on another page to this one is followed, to the page alone, not into a frame.
    let link = "Sec-Fetch-Site: cross-site\nSec-Fetch-Mode: navigate\nSec-Fetch-Dest";
    let linked = |to: &str| site.send(&format!("GET / HTTP/1.1\nHost: {host}\n{link}: {to}")).status;
    assert_eq!((linked("document"), linked("iframe")), (200, 403));
}

#[test]
fn requests_that_are_odd_large_or_slow_are_refused() {
    let desk = desk_with_frames(1);
    let site = Site::start(&desk, &[]);
    let host = site.host();
    for path in [
        "/../../etc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "/..%2f..%2fetc%2fpasswd",
        "//etc/passwd",
        "/page.js/../../scene.toml",
        "/night.db",
        "/api",
        "/api/segments/../../../etc/passwd",
    ] {
        let answer = site.get(path);
        assert!([400, 404].contains(&answer.status), "{path}: {}", answer.status);
        assert!(!answer.body.contains("root:") && !answer.body.contains("[pupil]"), "{path}");
    }
    for path in [
        "/api/segments/x",
        "/api/segments/-1",
        "/api/segments/7",
        "/api/frames/0",
        "/api/frames/99",
        "/api/trend?limit=x",
        "/api/trend?limit=99999999999",
        "/api/frames?after=-5",
    ] {
        let answer = site.get(path);
        assert_eq!(answer.status, 400, "{path}: {}", answer.body);
        assert!(answer.body.contains("error"), "{path}: {}", answer.body);
    }
    for method in ["POST", "PUT", "DELETE", "OPTIONS", "PATCH", "TRACE"] {
        assert_eq!(site.send(&format!("{method} /api/status HTTP/1.1\nHost: {host}")).status, 405, "{method}");
    }
    assert_eq!(site.send(&format!("GET / HTTP/1.1\nHost: {host}\nContent-Length: 1000000000000")).status, 413);
    assert_eq!(site.send(&format!("GET / HTTP/1.1\nHost: {host}\nTransfer-Encoding: chunked")).status, 413);
    // Headers and addresses beyond the limit: refused, or closed unanswered while they are still
    // sent.
    let large = "x".repeat(100_000);
    assert!([0, 431].contains(&site.send(&format!("GET / HTTP/1.1\nHost: {host}\nX-Large: {large}")).status));
    assert!([0, 414, 431].contains(&site.send(&format!("GET /{large} HTTP/1.1\nHost: {host}")).status));
    assert!([0, 400].contains(&site.send("\u{1}\u{2}\u{3} nonsense").status));
    // Requests that never end are closed by the server, and hinder no other; so are connections
    // beyond the limit.
    let mut slow: Vec<TcpStream> = (0..200).map(|_| site.connect()).collect();
    for stream in &mut slow {
        let _ = stream.write_all(b"GET / HTTP/1.1\r\nHo");
    }
    let mut ended = Vec::new();
    for stream in &mut slow {
        // Ends by a close of the server; the patience of the socket would be an error of another
        // kind.
        let outcome = stream.read_to_end(&mut ended);
        let is_time = |error: &std::io::Error| {
            matches!(error.kind(), std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut)
        };
        assert!(!outcome.as_ref().is_err_and(is_time), "{outcome:?}");
    }
    assert_eq!(site.get("/api/status").status, 200);
}

#[test]
fn other_addresses_need_a_token_and_requests_too() {
    let desk = desk_with_frames(1);
    let open = [&WATCH[..], &["--port", "0", "--listen", "0.0.0.0"]].concat();
    desk.run(&open).failed(&open, &["--listen 0.0.0.0", "token", "COPHASE_TOKEN"]);
    let weak = [&open[..], &["--token", "short"]].concat();
    desk.run(&weak).failed(&weak, &["token", "16 to 256"]);
    let token = "correct-horse-battery-staple";
    let site = Site::start(&desk, &["--listen", "0.0.0.0", "--token", token]);
    let host = site.host();
    let with = |path: &str, line: &str| site.send(&format!("GET {path} HTTP/1.1\nHost: {host}\n{line}"));
    for (path, line) in [
        ("/", "Accept: */*"),
        ("/page.js", "Accept: */*"),
        ("/api/status", "Authorization: Bearer correct-horse-battery-stapl"),
        ("/api/status", "Authorization: Bearer correct-horse-battery-staple2"),
        ("/api/status", "Authorization: Basic correct-horse-battery-staple"),
        ("/api/status?token=correct-horse-battery-staple", "Accept: */*"),
        ("/?token=wrong", "Accept: */*"),
        ("/api/changes", "Cookie: cophase-1=correct-horse-battery-staple"),
    ] {
        let answer = with(path, line);
        assert_eq!(answer.status, 401, "{path} {line}");
        assert!(!answer.body.contains("counts") && !answer.body.contains(token), "{path} {line}");
    }
    assert_eq!(with("/api/status", &format!("Authorization: Bearer {token}")).status, 200);
    let entered = with(&format!("/?token={token}"), "Accept: */*");
    assert_eq!(entered.status, 303);
    assert!(entered.head.contains("location: /\r\n") || entered.head.ends_with("location: /"), "{}", entered.head);
    assert!(entered.head.contains("httponly; samesite=strict"), "{}", entered.head);
    let cookie = format!("Cookie: other=1; cophase-{}={token}", site.address.port());
    assert_eq!(with("/api/status", &cookie).status, 200);
    // The token does not open the page to other sites.
    assert_eq!(with("/api/status", &format!("{cookie}\nOrigin: http://evil.example")).status, 403);
}

/// Clients that send `request` many times and read nothing.
fn silent_readers(site: &Site, count: usize, request: &str) -> Vec<TcpStream> {
    let many = request.repeat(4000);
    let connect = |_| {
        let mut stream = site.connect();
        // Until the buffers of the connection are full.
        stream.set_write_timeout(Some(std::time::Duration::from_millis(20))).unwrap();
        let _ = stream.write_all(many.as_bytes());
        stream
    };
    (0..count).map(connect).collect()
}

#[test]
fn clients_that_read_nothing_do_not_keep_the_owner_out() {
    let desk = desk_with_frames(1);
    let token = "correct-horse-battery-staple";
    let site = Site::start(&desk, &["--listen", "0.0.0.0", "--token", token]);
    let host = site.host();
    let owner = format!("GET /api/status HTTP/1.1\nHost: {host}\nAuthorization: Bearer {token}");
    let without_token = silent_readers(&site, 100, &format!("GET /page.js HTTP/1.1\r\nHost: {host}\r\n\r\n"));
    assert_eq!(site.send(&owner).status, 200);
    drop(without_token);
    // Who knows the token and reads nothing is no better, as soon as the answers wait for them.
    let request = format!("GET /charts.js HTTP/1.1\r\nHost: {host}\r\nAuthorization: Bearer {token}\r\n\r\n");
    let known = silent_readers(&site, 100, &request);
    wait_until("the answer to the owner", || site.send(&owner).status == 200);
    drop(known);
}

#[test]
fn used_port_is_reported() {
    let desk = desk_with_frames(1);
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let arguments = [&WATCH[..], &["--port", &port]].concat();
    let done = desk.run(&arguments);
    done.failed(&arguments, &["cannot listen on 127.0.0.1", "--port"]);
}
