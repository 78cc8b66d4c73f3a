//! Guard of the page: what a request must be before anything is answered.
//!
//! A browser of this machine that shows another site can send requests here. It is refused by the
//! host that it names (DNS rebinding gives a name of the other site to this address), by its
//! `Origin`, and by `Sec-Fetch-Site`.

use super::connections::Connection;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;

/// Nothing but the page's own files, and no page may frame it.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; base-uri 'none'; \
                      form-action 'none'; frame-ancestors 'none'";

/// Who may ask.
pub struct Guard {
    /// Where the page listens.
    pub address: SocketAddr,
    /// Names of this machine that are accepted besides addresses.
    pub hosts: Vec<String>,
    /// What every request must know.
    pub token: Option<String>,
}

/// Answers a request that is refused, gives others to `next`, and adds the headers of security to
/// both.
pub async fn guard(State(guard): State<Arc<Guard>>, request: Request, next: Next) -> Response {
    let mut response = match guard.decide(&request) {
        Decision::Pass => {
            if let Some(connection) = request.extensions().get::<Arc<Connection>>() {
                connection.admit();
            }
            next.run(request).await
        }
        Decision::Answer(response) => *response,
    };
    let headers = response.headers_mut();
    let fixed = [
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::X_FRAME_OPTIONS, "DENY"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::CACHE_CONTROL, "no-store"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
        (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    ];
    for (name, value) in fixed {
        headers.insert(name, HeaderValue::from_static(value));
    }
    response
}

enum Decision {
    Pass,
    Answer(Box<Response>),
}

fn refuse(status: StatusCode, sentence: &str) -> Decision {
    // What is sent behind a request that is refused is not even read.
    let close = [(header::CONNECTION, "close")];
    Decision::Answer(Box::new((status, close, format!("{sentence}\n")).into_response()))
}

impl Guard {
    fn decide(&self, request: &Request) -> Decision {
        let headers = request.headers();
        if request.method() != Method::GET && request.method() != Method::HEAD {
            let refused = (
                StatusCode::METHOD_NOT_ALLOWED,
                [(header::ALLOW, "GET, HEAD"), (header::CONNECTION, "close")],
                "only GET is accepted\n",
            );
            return Decision::Answer(Box::new(refused.into_response()));
        }
        let has_length = headers.get(header::CONTENT_LENGTH).is_some_and(|length| length != "0");
        if has_length || headers.contains_key(header::TRANSFER_ENCODING) {
            return refuse(StatusCode::PAYLOAD_TOO_LARGE, "a request has no body here");
        }
        let Some(host) = only(headers, &header::HOST).filter(|host| self.is_own(host)) else {
            return refuse(
                StatusCode::MISDIRECTED_REQUEST,
                "this host is not the one of the page: --host names others",
            );
        };
        if headers.contains_key(header::ORIGIN) && only(headers, &header::ORIGIN) != Some(&format!("http://{host}")) {
            return refuse(StatusCode::FORBIDDEN, "requests of other sites are refused");
        }
        let site = only(headers, &HeaderName::from_static("sec-fetch-site"));
        let is_link = request.uri().path() == "/"
            && only(headers, &HeaderName::from_static("sec-fetch-mode")) == Some("navigate")
            && only(headers, &HeaderName::from_static("sec-fetch-dest")) == Some("document");
        if site.is_some_and(|site| site != "same-origin" && site != "none") && !is_link {
            return refuse(StatusCode::FORBIDDEN, "requests of other sites are refused");
        }
        self.check_token(request)
    }

    /// A token in the address of the page becomes a cookie, so that it is in no history of
    /// addresses for long.
    fn check_token(&self, request: &Request) -> Decision {
        let Some(token) = &self.token else { return Decision::Pass };
        let headers = request.headers();
        let name = format!("cophase-{}=", self.address.port());
        let bearer = only(headers, &header::AUTHORIZATION).and_then(|value| value.strip_prefix("Bearer "));
        let cookies = headers.get_all(header::COOKIE).iter().filter_map(|value| value.to_str().ok());
        let mut cookies = cookies.flat_map(|value| value.split(';')).filter_map(|pair| pair.trim().strip_prefix(&name));
        if bearer.is_some_and(|given| is_same(given, token)) || cookies.any(|given| is_same(given, token)) {
            return Decision::Pass;
        }
        let query = request.uri().query().unwrap_or_default();
        let given = query.split('&').find_map(|pair| pair.strip_prefix("token="));
        if request.uri().path() == "/" && given.is_some_and(|given| is_same(given, token)) {
            let cookie = format!("{name}{token}; HttpOnly; SameSite=Strict; Path=/");
            let answer = (StatusCode::SEE_OTHER, [(header::LOCATION, "/".to_string()), (header::SET_COOKIE, cookie)]);
            return Decision::Answer(Box::new(answer.into_response()));
        }
        refuse(StatusCode::UNAUTHORIZED, "a token is needed: open /?token=TOKEN, or send Authorization: Bearer TOKEN")
    }

    /// Whether `host` is a name of this page. Addresses are no names that another site could point
    /// here.
    fn is_own(&self, host: &str) -> bool {
        let (name, port) =
            match host.rsplit_once(':').filter(|(_, port)| port.bytes().all(|byte| byte.is_ascii_digit())) {
                Some((name, port)) => (name, port.parse().ok()),
                None => (host, Some(80)),
            };
        if port != Some(self.address.port()) {
            return false;
        }
        let address = name.trim_start_matches('[').trim_end_matches(']').parse::<IpAddr>();
        match address {
            Ok(address) => address.is_loopback() || !self.address.ip().is_loopback(),
            Err(_) => {
                name.eq_ignore_ascii_case("localhost") || self.hosts.iter().any(|host| host.eq_ignore_ascii_case(name))
            }
        }
    }
}

/// The only header of this name.
fn only<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Option<&'a str> {
    let mut values = headers.get_all(name).iter();
    let value = values.next()?;
    if values.next().is_some() { None } else { value.to_str().ok() }
}

/// Whether two texts are the same, in a time that does not tell where they differ.
fn is_same(one: &str, other: &str) -> bool {
    let difference = one.bytes().zip(other.bytes()).fold(0, |sum, (one, other)| sum | (one ^ other));
    one.len() == other.len() && std::hint::black_box(difference) == 0
}

/// Whether a token is fit for an address and a header: letters, digits, `-`, `_`, at least 16 of
/// them.
pub fn is_token(text: &str) -> bool {
    (16..=256).contains(&text.len())
        && text.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'-' || byte == b'_')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hosts_of_others_are_refused() {
        let guard = |address: &str, hosts: &[&str]| Guard {
            address: address.parse().unwrap(),
            hosts: hosts.iter().map(ToString::to_string).collect(),
            token: None,
        };
        let local = guard("127.0.0.1:8642", &[]);
        for host in ["127.0.0.1:8642", "localhost:8642", "LOCALHOST:8642", "[::1]:8642"] {
            assert!(local.is_own(host), "{host}");
        }
        for host in
            ["evil.example:8642", "127.0.0.1", "127.0.0.1:80", "10.0.0.1:8642", "", "localhost.evil.example:8642"]
        {
            assert!(!local.is_own(host), "{host}");
        }
        let open = guard("0.0.0.0:80", &["summit"]);
        for host in ["10.0.0.1", "summit", "summit:80"] {
            assert!(open.is_own(host), "{host}");
        }
        assert!(!open.is_own("evil.example"));
    }

    #[test]
    fn tokens_are_compared_whole() {
        assert!(is_same("secret", "secret"));
        for other in ["", "secre", "secrets", "Secret"] {
            assert!(!is_same("secret", other), "{other}");
        }
        assert!(is_token("0123456789abcdef") && !is_token("short") && !is_token("0123456789abcde;"));
    }
}
