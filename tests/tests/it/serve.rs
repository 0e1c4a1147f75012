//! `mcvl serve`: what a browser and a stranger get from it.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::path::Path;
use std::time::Duration;

use mcvl_tests::{Server, mcvl, run, scratch};

/// A connection on which a request was sent and that stays open.
fn ask(server: &Server, method: &str, path: &str) -> TcpStream {
    let address = server.origin().strip_prefix("http://").unwrap();
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    write!(stream, "{method} {path} HTTP/1.1\r\nHost: {address}\r\n\r\n").unwrap();
    stream
}

/// The head of the answer, in lower case.
fn head(stream: &mut TcpStream) -> String {
    let mut seen = Vec::new();
    let mut byte = [0];
    while !seen.ends_with(b"\r\n\r\n") {
        assert_eq!(stream.read(&mut byte).unwrap(), 1, "the connection ended");
        seen.push(byte[0]);
    }
    String::from_utf8(seen).unwrap().to_lowercase()
}

#[test]
fn files_have_the_types_that_browsers_insist_on() {
    let server = Server::start(None);
    let page = std::fs::read_to_string(mcvl_tests::root().join("www/index.html")).unwrap();
    let policy = page.split("Content-Security-Policy\" content=\"").nth(1).unwrap().split('"').next().unwrap();
    for (path, expected) in [
        ("/", "text/html"),
        ("/page.js", "text/javascript"),
        ("/style.css", "text/css"),
        ("/pkg/simd_bg.wasm", "application/wasm"),
    ] {
        let head = head(&mut ask(&server, "HEAD", path));
        assert!(head.starts_with("http/1.1 200 "), "{path}: {head}");
        assert!(head.contains(&format!("\r\ncontent-type: {expected}")), "{path}: {head}");
        assert!(head.contains("\r\nx-content-type-options: nosniff\r\n"), "{path}: {head}");
        assert!(head.contains("\r\ncache-control: no-cache\r\n"), "{path}: {head}");
        assert!(head.contains(&format!("\r\ncontent-security-policy: {policy}\r\n")), "{path}: {head}");
    }
}

#[test]
fn files_go_compressed_to_who_can_read_that() {
    let server = Server::start(None);
    let address = server.origin().strip_prefix("http://").unwrap();
    let size = |accepted: &str| {
        let mut stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        write!(stream, "GET /tapes/reacher.json HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n{accepted}\r\n")
            .unwrap();
        let head = head(&mut stream);
        let mut body = Vec::new();
        stream.read_to_end(&mut body).unwrap();
        (head.contains("\r\ncontent-encoding: gzip\r\n"), body.len())
    };
    let (plain, packed) = (size(""), size("Accept-Encoding: gzip\r\n"));
    assert_eq!((plain.0, packed.0), (false, true));
    assert!(10 * packed.1 < plain.1, "{packed:?} {plain:?}");
}

#[test]
fn nothing_outside_the_page_is_served_and_nothing_is_taken() {
    let server = Server::start(None);
    for path in ["/../Cargo.toml", "/..%2fCargo.toml", "/%2e%2e/Cargo.toml", "//etc/passwd", "/pkg/../../Cargo.toml"] {
        let head = head(&mut ask(&server, "GET", path));
        assert!(head.starts_with("http/1.1 404 ") || head.starts_with("http/1.1 400 "), "{path}: {head}");
    }
    let head = head(&mut ask(&server, "POST", "/"));
    assert!(head.starts_with("http/1.1 405 "), "{head}");
}

#[test]
fn connections_that_stay_open_keep_nobody_waiting() {
    // A browser opens six or more at once and holds them.
    let server = Server::start(None);
    for _ in 0..20 {
        let mut streams: Vec<TcpStream> = (0..24).map(|_| ask(&server, "HEAD", "/page.js")).collect();
        for stream in &mut streams {
            assert!(head(stream).starts_with("http/1.1 200 "));
        }
    }
}

#[test]
fn a_run_is_served_as_a_tape() {
    let folder = scratch();
    let place = folder.path().join("run");
    let settings = ["safe_steps=200", "full_steps=60", "forecast=40", "evaluations=2", "rollouts=1"];
    let mut train = std::process::Command::new(mcvl());
    train.args(["train", "box-moving", "--seed", "3", "-q", "-o"]).arg(&place);
    run(train.args(settings.iter().flat_map(|setting| ["--set", setting]))).unwrap();

    let server = Server::start(Some(&place));
    assert_eq!(server.link, format!("{}/?tape=run/seed-3.json", server.origin()));
    let (head, body) = server.get("/run/seed-3.json");
    assert!(head.starts_with("http/1.1 200 ") && head.contains("application/json"), "{head}");
    let tape: serde_json::Value = serde_json::from_str(&body).unwrap();
    assert_eq!((&tape["format"], &tape["version"]), (&"mcvl tape".into(), &1.into()));
    assert!(tape["configuration"].as_str().unwrap().starts_with("env=box-moving "));
    assert_eq!(tape["world"]["actions"]["discrete"][0], "up");
    assert_eq!(tape["legs"].as_array().unwrap().len(), 3);
    assert_eq!(tape["evaluations"].as_array().unwrap().len(), 9);
    let ledger = std::fs::read_to_string(place.join("seed-3/ledger.jsonl")).unwrap();
    let checks = tape["checks"].as_array().unwrap();
    assert_eq!(checks.len(), ledger.lines().count());
    assert!(!checks.is_empty() && checks.iter().all(|check| check["modified"]["films"].is_array()));

    assert!(server.get("/run/seed-4.json").0.starts_with("http/1.1 404 "));
    assert!(server.get("/run/..%2f..%2fmanifest.json").0.starts_with("http/1.1 404 "));
}

#[test]
fn what_cannot_be_served_is_said() {
    let folder = scratch();
    let serve = |arguments: &[&Path]| {
        let mut command = std::process::Command::new(mcvl());
        command.args(["serve", "--port", "0"]).args(arguments).current_dir(folder.path());
        let output = command.output().unwrap();
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    let (code, said) = serve(&[]);
    assert_eq!(code, Some(2));
    assert!(said.contains("the page is not in www") && said.contains("cargo xtask web"), "{said}");
    let page = mcvl_tests::root().join("www");
    let (code, said) = serve(&[Path::new("--page"), &page, Path::new("none")]);
    assert!(code == Some(2) && said.contains("none"), "{code:?} {said}");
}
