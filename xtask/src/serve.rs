//! A static server on the loopback address, for the page.

use std::fs::File;
use std::path::{Component, Path, PathBuf};

use anyhow::{Context, Result, anyhow};
use tiny_http::{Header, Method, Request, Response, Server};

/// Port unless another is asked for.
pub const PORT: u16 = 8000;

/// Serves a folder until the program is stopped.
pub fn serve(folder: &Path, port: u16) -> Result<()> {
    let folder = folder.canonicalize().with_context(|| format!("{}: there is no such folder", folder.display()))?;
    let server = Server::http(("127.0.0.1", port)).map_err(|error| {
        anyhow!("port {port} cannot be used ({error}): choose another with --port, or let 0 find a free one")
    })?;
    println!("http://{} (stop with Ctrl-C)", server.server_addr());
    for request in server.incoming_requests() {
        let line = format!("{} {}", request.method(), request.url());
        // A browser that goes away in the middle is no reason to stop.
        if let Err(error) = answer(&folder, request) {
            eprintln!("{line}: {error}");
        }
    }
    Ok(())
}

fn answer(folder: &Path, request: Request) -> std::io::Result<()> {
    if !matches!(request.method(), Method::Get | Method::Head) {
        return request.respond(Response::from_string("only GET and HEAD\n").with_status_code(405));
    }
    let opened = resolve(folder, request.url()).and_then(|path| Some((File::open(&path).ok()?, path)));
    let Some((file, path)) = opened else {
        return request.respond(Response::from_string("not found\n").with_status_code(404));
    };
    let mut response = Response::from_file(file);
    // `no-cache`: what was just rebuilt is what the browser gets.
    for (name, value) in
        [("Content-Type", media_type(&path)), ("Cache-Control", "no-cache"), ("X-Content-Type-Options", "nosniff")]
    {
        response.add_header(Header::from_bytes(name, value).expect("headers of plain text are valid"));
    }
    request.respond(response)
}

/// The file that a request names, if it lies in the folder.
fn resolve(folder: &Path, url: &str) -> Option<PathBuf> {
    let path = url.split(['?', '#']).next()?.strip_prefix('/')?;
    let path = Path::new(path);
    // No file of the page needs percent-encoding, so a name that has some is just not found.
    if !path.components().all(|part| matches!(part, Component::Normal(_))) {
        return None;
    }
    let mut file = folder.join(path);
    if file.is_dir() {
        file.push("index.html");
    }
    // Links are followed, but not out of the folder.
    let file = file.canonicalize().ok()?;
    (file.is_file() && file.starts_with(folder)).then_some(file)
}

/// Media type by file name. Browsers insist on those of modules, scripts and styles.
fn media_type(path: &Path) -> &'static str {
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("html") => "text/html; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("js" | "mjs") => "text/javascript; charset=utf-8",
        Some("json") => "application/json",
        Some("svg") => "image/svg+xml",
        Some("png") => "image/png",
        Some("ico") => "image/x-icon",
        Some("wasm") => "application/wasm",
        Some("txt" | "md") => "text/plain; charset=utf-8",
        _ => "application/octet-stream",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_files_of_the_folder_are_found() {
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src").canonicalize().unwrap();
        assert_eq!(resolve(&source, "/serve.rs?v=1"), Some(source.join("serve.rs")));
        for outside in
            ["/../Cargo.toml", "/..%2fCargo.toml", "/./../Cargo.toml", "//etc/passwd", "serve.rs", "/none.rs", "/"]
        {
            assert_eq!(resolve(&source, outside), None, "{outside}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn links_do_not_lead_out() {
        let folder = std::env::temp_dir().canonicalize().unwrap().join(format!("xtask-serve-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join("index.html"), "page").unwrap();
        std::os::unix::fs::symlink(env!("CARGO_MANIFEST_DIR"), folder.join("link")).unwrap();
        let (page, outside) = (resolve(&folder, "/"), resolve(&folder, "/link/Cargo.toml"));
        std::fs::remove_dir_all(&folder).unwrap();
        assert_eq!(page, Some(folder.join("index.html")));
        assert_eq!(outside, None);
    }

    #[test]
    fn media_types_that_browsers_insist_on() {
        assert_eq!(media_type(Path::new("a/b.wasm")), "application/wasm");
        assert_eq!(media_type(Path::new("page.js")), "text/javascript; charset=utf-8");
        assert_eq!(media_type(Path::new("none")), "application/octet-stream");
    }
}
