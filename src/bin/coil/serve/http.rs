//! A file server for one page on loopback: no caching, nothing outside its folders.

use super::build::Board;
use anyhow::{Context, anyhow};
use std::fs::File;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tiny_http::{Header, Method, Request, Response, ResponseBox, Server};

/// Requests answered at the same time: workers fetch the module side by side.
const THREADS: usize = 4;

/// Isolated from other origins and never cached; each is allowed for a page without foreign content.
const HEADERS: [(&str, &str); 5] = [
    ("Cache-Control", "no-store"),
    ("Cross-Origin-Opener-Policy", "same-origin"),
    ("Cross-Origin-Embedder-Policy", "require-corp"),
    ("Cross-Origin-Resource-Policy", "same-origin"),
    ("X-Content-Type-Options", "nosniff"),
];

/// What is served.
pub struct Site {
    /// Searched in turn for a requested file.
    pub folders: Vec<PathBuf>,
    /// Served as `/build-status.json`.
    pub board: Arc<Board>,
}

/// Listens on loopback at `port`, or where that is taken at a port that the system picks.
pub fn listen(port: u16) -> anyhow::Result<Server> {
    let addresses = [port, 0].map(|port| SocketAddr::from((Ipv4Addr::LOCALHOST, port)));
    Server::http(&addresses[..]).map_err(|error| anyhow!("cannot listen on 127.0.0.1: {error}"))
}

/// Answers requests until the server is unblocked.
pub fn serve(server: &Server, site: &Site) {
    std::thread::scope(|scope| {
        for _ in 0..THREADS {
            scope.spawn(|| {
                while let Ok(request) = server.recv() {
                    respond(request, site);
                }
            });
        }
    });
}

fn respond(request: Request, site: &Site) {
    let mut response = match request.method() {
        Method::Get | Method::Head => answer(request.url(), site),
        _ => plain(405, "only GET and HEAD"),
    };
    for (name, value) in HEADERS {
        response.add_header(header(name, value));
    }
    // an error here means that the browser went away
    let _ = request.respond(response);
}

fn answer(url: &str, site: &Site) -> ResponseBox {
    let Some(path) = relative_path(url) else {
        return plain(400, "this path is not served");
    };
    if path == Path::new("build-status.json") {
        let json = header("Content-Type", content_type(&path));
        return Response::from_string(site.board.to_json()).with_header(json).boxed();
    }
    match site.folders.iter().find_map(|folder| open_file(&folder.join(&path)).ok()) {
        Some(file) => {
            Response::from_file(file).with_header(header("Content-Type", content_type(&path))).boxed()
        }
        None => plain(404, "no such file"),
    }
}

fn open_file(path: &Path) -> anyhow::Result<File> {
    let file = File::open(path)?;
    file.metadata()?.is_file().then_some(file).context("not a file")
}

/// The file that a request's URL names, relative to a served folder: `/` and `/a/` mean `index.html`.
/// None for whatever could lead outside (`..`, an absolute or hidden name, a drive letter).
fn relative_path(url: &str) -> Option<PathBuf> {
    let path = url.split(['?', '#']).next()?.strip_prefix('/')?;
    let path = percent_decode(path)?;
    let path = if path.is_empty() || path.ends_with('/') { path + "index.html" } else { path };
    let safe = |name: &str| !name.is_empty() && !name.starts_with('.') && !name.contains(['\\', ':', '\0']);
    path.split('/').all(safe).then(|| path.split('/').collect())
}

fn percent_decode(text: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.bytes();
    while let Some(byte) = rest.next() {
        bytes.push(if byte == b'%' {
            let digit = |byte: u8| char::from(byte).to_digit(16);
            u8::try_from(16 * digit(rest.next()?)? + digit(rest.next()?)?).ok()?
        } else {
            byte
        });
    }
    String::from_utf8(bytes).ok()
}

fn content_type(path: &Path) -> &'static str {
    match path.extension().and_then(|extension| extension.to_str()).unwrap_or_default() {
        "html" => "text/html; charset=utf-8",
        "js" | "mjs" => "text/javascript; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "json" | "map" => "application/json",
        "wasm" => "application/wasm",
        "svg" => "image/svg+xml",
        "png" => "image/png",
        "ico" => "image/x-icon",
        "woff2" => "font/woff2",
        "txt" | "md" | "ts" => "text/plain; charset=utf-8",
        _ => "application/octet-stream",
    }
}

fn plain(status: u16, text: &str) -> ResponseBox {
    let kind = header("Content-Type", "text/plain; charset=utf-8");
    Response::from_string(text).with_status_code(status).with_header(kind).boxed()
}

fn header(name: &str, value: &str) -> Header {
    Header::from_bytes(name, value).expect("our headers are ASCII")
}

#[cfg(test)]
mod tests {
    use super::super::build::State;
    use super::*;
    use std::io::{Read, Write};
    use std::net::TcpStream;

    #[test]
    fn urls_name_files_inside_the_folder() {
        for (url, path) in [
            ("/", "index.html"),
            ("/?object=ball#top", "index.html"),
            ("/pkg/core/coil_ps.js", "pkg/core/coil_ps.js"),
            ("/docs/", "docs/index.html"),
            ("/a%20b%C3%BC.png", "a bü.png"),
        ] {
            assert_eq!(relative_path(url), Some(PathBuf::from(path)), "{url}");
        }
    }

    #[test]
    fn urls_that_lead_outside_are_refused() {
        for url in [
            "/../Cargo.toml",
            "/%2e%2e/Cargo.toml",
            "/pkg/..%2f..%2fCargo.toml",
            "//etc/passwd",
            "/%2fetc/passwd",
            "/.git/config",
            "/..%5cCargo.toml",
            "/C:/windows/win.ini",
            "/a%00.js",
            "/%f",
            "/%ff",
            "/%+5a",
            "http://elsewhere/",
            "",
        ] {
            assert_eq!(relative_path(url), None, "{url}");
        }
    }

    /// Status line, headers and body that a fresh server with one `index.html` answers.
    fn exchange(request: &str) -> String {
        let folder = std::env::temp_dir().join(format!(
            "coil-serve-{}-{:?}",
            std::process::id(),
            std::thread::current().id()
        ));
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join("index.html"), "<p>page").unwrap();
        std::fs::write(folder.join("m.wasm"), b"\0asm").unwrap();
        let board = Arc::new(Board::default());
        board.set("core", State::Waiting);
        let site = Site { folders: vec![folder.join("missing"), folder.clone()], board };
        let server = listen(0).unwrap();
        let mut answer = String::new();
        std::thread::scope(|scope| {
            scope.spawn(|| serve(&server, &site));
            let mut stream = TcpStream::connect(server.server_addr().to_ip().unwrap()).unwrap();
            write!(stream, "{request} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").unwrap();
            stream.read_to_string(&mut answer).unwrap();
            for _ in 0..THREADS {
                server.unblock();
            }
        });
        std::fs::remove_dir_all(&folder).unwrap();
        answer
    }

    #[test]
    fn the_page_comes_with_its_type_and_uncached() {
        let answer = exchange("GET /?planner=coil");
        assert!(answer.starts_with("HTTP/1.1 200") && answer.ends_with("<p>page"), "{answer}");
        assert!(
            answer.contains("Content-Type: text/html") && answer.contains("Cache-Control: no-store"),
            "{answer}"
        );
        assert!(exchange("GET /m.wasm").contains("Content-Type: application/wasm"));
    }

    #[test]
    fn head_has_no_body_and_post_is_refused() {
        let answer = exchange("HEAD /");
        assert!(answer.starts_with("HTTP/1.1 200") && !answer.contains("<p>"), "{answer}");
        assert!(exchange("POST /").starts_with("HTTP/1.1 405"));
    }

    #[test]
    fn missing_and_outside_files_are_told_apart() {
        assert!(exchange("GET /nothing.js").starts_with("HTTP/1.1 404"));
        assert!(exchange("GET /%2e%2e/secret").starts_with("HTTP/1.1 400"));
    }

    #[test]
    fn build_status_is_the_board() {
        let answer = exchange("GET /build-status.json");
        assert!(answer.ends_with(r#"{"modules":{"core":{"state":"waiting"}}}"#), "{answer}");
    }

    #[test]
    fn a_taken_port_is_replaced() {
        let first = listen(0).unwrap();
        let taken = first.server_addr().to_ip().unwrap().port();
        let second = listen(taken).unwrap();
        assert_ne!(second.server_addr().to_ip().unwrap().port(), taken);
    }
}
