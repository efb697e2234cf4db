//! The page's files, which are part of the program: it needs neither a folder nor the internet.

use axum::body::Body;
use axum::extract::Path;
use axum::http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE};
use axum::http::{HeaderName, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const JAVASCRIPT: &str = "text/javascript; charset=utf-8";
const SVG: &str = "image/svg+xml";

/// Every file with its type.
const FILES: [(&str, &str, &str); 10] = [
    ("index.html", HTML, include_str!("../web/index.html")),
    ("style.css", CSS, include_str!("../web/style.css")),
    ("app.js", JAVASCRIPT, include_str!("../web/app.js")),
    ("link.js", JAVASCRIPT, include_str!("../web/link.js")),
    ("messages.js", JAVASCRIPT, include_str!("../web/messages.js")),
    ("map.js", JAVASCRIPT, include_str!("../web/map.js")),
    ("hand.js", JAVASCRIPT, include_str!("../web/hand.js")),
    ("fence.js", JAVASCRIPT, include_str!("../web/fence.js")),
    ("health.js", JAVASCRIPT, include_str!("../web/health.js")),
    ("icon.svg", SVG, include_str!("../web/icon.svg")),
];

/// Nothing from elsewhere runs in the page, and the page runs in no other.
const HEADERS: [(HeaderName, HeaderValue); 5] = [
    (
        CONTENT_SECURITY_POLICY,
        HeaderValue::from_static(
            "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; \
             base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
        ),
    ),
    (HeaderName::from_static("x-content-type-options"), HeaderValue::from_static("nosniff")),
    (HeaderName::from_static("referrer-policy"), HeaderValue::from_static("no-referrer")),
    (
        HeaderName::from_static("cross-origin-resource-policy"),
        HeaderValue::from_static("same-origin"),
    ),
    (CACHE_CONTROL, HeaderValue::from_static("no-cache")),
];

/// The page itself.
pub fn index() -> Response {
    find("index.html")
}

/// A file of the page.
pub async fn file(Path(name): Path<String>) -> Response {
    find(&name)
}

fn find(name: &str) -> Response {
    let found = FILES.iter().find(|(file, ..)| *file == name);
    found.map_or_else(
        || (StatusCode::NOT_FOUND, "there is no such file\n").into_response(),
        |(_, kind, content)| ([(CONTENT_TYPE, *kind)], *content).into_response(),
    )
}

/// Adds the headers that every response has.
pub fn with_headers(mut response: Response<Body>) -> Response<Body> {
    response.headers_mut().extend(HEADERS);
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_is_small_and_loads_nothing_from_elsewhere() {
        let bytes: usize = FILES.iter().map(|(_, _, content)| content.len()).sum();
        assert!(bytes < 100 << 10, "{bytes} bytes");
        for (name, kind, content) in FILES {
            let addresses = content.matches("://").count();
            let allowed =
                if kind == SVG { content.matches("http://www.w3.org/").count() } else { 0 };
            // `ws://` and `wss://` are made from the page's own address.
            assert!(addresses <= allowed + content.matches("ws://").count(), "{name}");
        }
    }

    #[test]
    fn every_file_that_the_page_names_exists() {
        let (_, _, index) = FILES[0];
        let named =
            index.split(['"']).filter(|text| text.ends_with(".js") || text.ends_with(".css"));
        for name in named {
            assert!(FILES.iter().any(|(file, ..)| *file == name), "{name}");
        }
        for (_, _, script) in FILES.iter().filter(|(_, kind, _)| *kind == JAVASCRIPT) {
            for import in script.split("from \"./").skip(1) {
                let name = import.split('"').next().unwrap();
                assert!(FILES.iter().any(|(file, ..)| *file == name), "{name}");
            }
        }
    }
}
