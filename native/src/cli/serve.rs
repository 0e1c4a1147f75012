//! `mcvl serve`: the page, with a run on it, for this machine's browser.

use std::io::Write as _;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use axum::Router;
use axum::extract::{Path as Segment, State};
use axum::http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, X_CONTENT_TYPE_OPTIONS};
use axum::http::{HeaderValue, StatusCode};
use axum::response::IntoResponse;
use axum::routing::get;
use clap::Args;
use mcvl::runs::{Reader, RunDir, RunsError, run_tape};
use tokio::net::TcpListener;
use tower_http::compression::CompressionLayer;
use tower_http::services::ServeDir;
use tower_http::set_header::SetResponseHeaderLayer;

use super::inspect::named_seed;
use super::terminal::Terminal;
use super::{Done, usage};

/// What the page may load: its own files only. The page says the same of itself; its workers take theirs
/// from this header.
const POLICY: &str = "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; worker-src 'self'; \
                      connect-src 'self'; img-src data:; base-uri 'none'; form-action 'self'";

/// Arguments of `mcvl serve`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  mcvl serve                        the page, which trains live in the browser
  mcvl serve runs/box-moving        the page with the decisions of this run
  mcvl serve runs/box-moving/seed-3 --port 8080")]
pub struct ServeArgs {
    /// Run directory, or the folder of a seed in it, to show on the page
    run: Option<PathBuf>,
    /// Port; 0 takes a free one
    #[arg(long, default_value_t = 8000)]
    port: u16,
    /// Address to listen on; other machines can see the page only if this is changed
    #[arg(long, default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST), value_name = "ADDRESS")]
    host: IpAddr,
    /// Folder of the page, as `cargo xtask web` built it
    #[arg(long, default_value = "www", value_name = "FOLDER")]
    page: PathBuf,
}

/// Serves the page until the program is stopped.
pub fn serve(arguments: &ServeArgs, terminal: &mut Terminal) -> anyhow::Result<Done> {
    check_page(&arguments.page)?;
    let shown = arguments.run.as_deref().map(Shown::find).transpose()?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build()?;
    runtime.block_on(async {
        let address = SocketAddr::new(arguments.host, arguments.port);
        let listener = TcpListener::bind(address).await.with_context(|| {
            format!("{address} cannot be listened on; choose another port with --port, or let 0 find a free one")
        })?;
        let page = format!("http://{}/", listener.local_addr()?);
        writeln!(terminal.out, "{page} trains live in the browser (stop with Ctrl-C)")?;
        if let Some(Shown { run, seed }) = &shown {
            writeln!(terminal.out, "{page}?tape=run/seed-{seed}.json shows {}", run.run().path().display())?;
        }
        terminal.out.flush()?;
        axum::serve(listener, router(&arguments.page, shown.map(|shown| shown.run.run().clone()))).await?;
        Ok(Done::Well)
    })
}

/// The run that is served, and the seed that the page opens with.
pub(super) struct Shown {
    pub(super) run: Reader,
    pub(super) seed: u64,
}

impl Shown {
    pub(super) fn find(path: &Path) -> anyhow::Result<Self> {
        let run = Reader::open(path)?;
        let dir = named_seed(&run)?;
        // What cannot be shown is said before a browser asks for it.
        run.seed(&dir)?;
        Ok(Self { run, seed: dir.seed() })
    }
}

/// Says what is missing where the page is not there.
fn check_page(page: &Path) -> anyhow::Result<()> {
    for file in ["index.html", "pkg/simd_bg.wasm", "pkg/scalar_bg.wasm"] {
        if !page.join(file).is_file() {
            usage!(
                "the page is not in {}: {file} is missing; `cargo xtask web` builds it in the repository, --page says \
                 where it lies",
                page.display()
            );
        }
    }
    Ok(())
}

/// Files of the page, and tapes of the run under `run/`.
fn router(page: &Path, run: Option<RunDir>) -> Router {
    // `no-cache`: what was just rebuilt is what the browser gets.
    let headers = [(CACHE_CONTROL, "no-cache"), (CONTENT_SECURITY_POLICY, POLICY), (X_CONTENT_TYPE_OPTIONS, "nosniff")];
    let mut router = Router::new().fallback_service(ServeDir::new(page));
    if let Some(run) = run {
        router = router.merge(Router::new().route("/run/{tape}", get(tape)).with_state(run));
    }
    for (name, value) in headers {
        router = router.layer(SetResponseHeaderLayer::overriding(name, HeaderValue::from_static(value)));
    }
    // A tape is a thirtieth, the module that trains less than half.
    router.layer(CompressionLayer::new())
}

/// The tape `seed-N.json` of the run, made anew for each request: a run that goes on is shown as far as
/// it is.
async fn tape(State(run): State<RunDir>, Segment(name): Segment<String>) -> impl IntoResponse {
    let seed = name.strip_prefix("seed-").and_then(|rest| rest.strip_suffix(".json")?.parse().ok());
    let Some(seed) = seed.filter(|seed| run.seed(*seed).path().exists()) else {
        return (StatusCode::NOT_FOUND, plain(), format!("{}: no tape {name}\n", run.path().display()));
    };
    match Reader::open(run.path()).and_then(|run| run_tape(&run, seed, &|_| true)) {
        Ok(text) => (StatusCode::OK, [(CONTENT_TYPE, "application/json")], text),
        Err(error @ RunsError::Request(_)) => (StatusCode::NOT_FOUND, plain(), format!("{error}\n")),
        Err(error) => (StatusCode::INTERNAL_SERVER_ERROR, plain(), format!("{error}\n")),
    }
}

fn plain() -> [(axum::http::HeaderName, &'static str); 1] {
    [(CONTENT_TYPE, "text/plain; charset=utf-8")]
}
