//! Looks at the page as a visitor does, through a browser; takes its pictures.

use std::fs;
use std::io::{BufRead as _, BufReader, Write as _};
use std::process::{Child, Command, Stdio};

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};

use crate::mujoco;
use crate::process::{cargo, command, program, root, run};
use crate::setup::{self, Purpose};
use crate::web;

/// Where pictures of the page lie, for the documentation.
const PICTURES: &str = "docs/page";

/// Waits until a story was told to its verdict.
pub const TOLD: &str = "until:return performance.getEntriesByName('verdict').length > 0";
/// Waits until the live run is over.
pub const DONE: &str = "until:return document.getElementById('status').textContent.startsWith('Done')";

/// The page on a server of its own.
pub struct Page {
    server: Child,
    address: String,
}

impl Page {
    /// Builds the page and serves it.
    pub fn serve() -> Result<Self> {
        setup::ensure(Purpose::Test)?;
        web::build()?;
        run(cargo().args(["build", "--package", "mcvl-native"]).args(mujoco::features()))?;
        let mut serve = command(program("debug", "mcvl"));
        let mut server = serve.args(["serve", "--port", "0"]).stdout(Stdio::piped()).spawn()?;
        let mut line = String::new();
        BufReader::new(server.stdout.take().context("stdout is a pipe")?).read_line(&mut line)?;
        let address = line.split_whitespace().next().context("the server does not say its address")?.to_owned();
        Ok(Self { server, address })
    }

    /// Drives a browser: what came of every command of `tests/node/page.mjs`.
    pub fn drive(&self, commands: &[String]) -> Result<Vec<Value>> {
        let mut node = Command::new("node");
        node.arg(root().join("tests/node/page.mjs")).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut node = node.spawn().context("node cannot be started: `cargo xtask setup` installs it")?;
        node.stdin.take().context("stdin is a pipe")?.write_all(&serde_json::to_vec(commands)?)?;
        let output = node.wait_with_output()?;
        if !output.status.success() {
            bail!("the browser's script ended with {}", output.status);
        }
        Ok(serde_json::from_slice(&output.stdout)?)
    }

    /// Visits the page with this query.
    pub fn go(&self, query: &str) -> String {
        format!("go:{}{query}", self.address)
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

fn size(width: u32, height: u32) -> String {
    let metrics = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false });
    format!("cdp:Emulation.setDeviceMetricsOverride {metrics}")
}

fn media(features: &[(&str, &str)]) -> String {
    let features: Vec<Value> = features.iter().map(|(name, value)| json!({ "name": name, "value": value })).collect();
    format!("cdp:Emulation.setEmulatedMedia {}", json!({ "features": features }))
}

/// Waits until the visitor has driven so many steps of an episode.
fn driven(steps: usize) -> String {
    format!("until:return document.getElementById('drive-status').textContent.includes('after {steps} of ')")
}

/// Takes the pictures of the documentation anew.
pub fn pictures() -> Result<()> {
    let page = Page::serve()?;
    let folder = root().join(PICTURES);
    fs::create_dir_all(&folder)?;
    let file = |name: &str| folder.join(name).with_extension("webp").display().to_string();
    let shot = |name: &str| format!("shot:{}", file(name));
    let full = |name: &str| format!("full:{}", file(name));
    let stage =
        |number: u32| format!("until:return document.getElementById('stage').textContent.startsWith('{number} of 6')");
    let settle = "until:window.since ??= performance.now(); return performance.now() - since > 600".to_owned();
    let forget = "eval:delete window.since".to_owned();
    let mut commands = vec![size(1440, 900), page.go(""), stage(1), shot("surprise"), stage(4)];
    commands.extend([settle.clone(), shot("futures"), TOLD.into(), DONE.into(), forget.clone(), settle.clone()]);
    commands.extend([shot("refused"), full("desktop"), media(&[("prefers-color-scheme", "dark")]), shot("dark")]);
    let tablet = [media(&[]), size(768, 1024), page.go(""), TOLD.into(), DONE.into(), settle.clone(), shot("tablet")];
    commands.extend(tablet);
    let phone = [size(390, 844), page.go(""), TOLD.into(), DONE.into(), settle.clone(), shot("phone")];
    commands.extend(phone);
    commands.extend([media(&[("prefers-color-scheme", "dark")]), shot("phone-dark")]);
    let reduced = media(&[("prefers-reduced-motion", "reduce")]);
    let still = "until:return !document.getElementById('moment').hidden".to_owned();
    commands.extend([reduced, size(1440, 900), page.go(""), still, settle.clone(), shot("reduced-motion")]);
    let error = [media(&[]), page.go("?sed=1"), "until:return !document.getElementById('error').hidden".into()];
    commands.extend(error);
    commands.extend([settle.clone(), shot("malformed-link")]);
    let click = |part: &str| format!("eval:document.querySelector('{part}').click()");
    let look = |id: &str| format!("eval:document.getElementById('{id}').scrollIntoView()");
    let other = "?env=tomato-watering&seed=3&safe_steps=300&full_steps=300&epsilon_decay=100&forecast=20&evaluations=2\
                 &rollouts=2";
    commands.extend([size(1440, 1000), page.go(other), DONE.into(), click("#drive-start"), driven(0)]);
    // To the bucket, from which every tomato looks watered.
    for (index, key) in ["ArrowUp", "ArrowRight", "ArrowRight", "ArrowRight", "ArrowUp"].into_iter().enumerate() {
        commands.extend([format!("keys:{key}"), driven(index + 1)]);
    }
    let stop = [click("#wheel > p button"), "until:return document.querySelector('#wheel table')".to_owned()];
    commands.extend(stop.clone());
    commands.extend([look("drive"), shot("drive"), click("#decide")]);
    commands.extend(["until:return document.body.dataset.vote === 'open'".into(), look("decision"), shot("vote")]);
    let arm = "until:return !document.getElementById('drive-start').hidden".to_owned();
    commands.extend([page.go("?env=reacher&seed=4"), arm, click("#drive-start"), driven(0)]);
    let keys = [&["ArrowLeft"; 4][..], &["ArrowUp"; 3], &["Space"; 9]].concat();
    for (index, key) in keys.into_iter().enumerate() {
        commands.extend([format!("keys:{key}"), driven(index + 1)]);
    }
    commands.extend(stop);
    commands.extend([look("drive"), shot("arm")]);
    commands.extend([page.go("?env=rocks-and-diamonds"), TOLD.into(), settle.clone(), shot("recorded")]);
    commands.extend([page.go("?seed=0&forecast=100&trap=9:5"), DONE.into(), click("#sets summary")]);
    commands.extend(["until:return document.querySelector('#comparison tbody tr:nth-child(5)')".into()]);
    commands.extend([click("#comparison tbody tr:nth-child(5) input"), look("results"), settle, shot("compare")]);
    commands.extend([click("#red-team-start"), "until:return document.querySelector('#red-team-desk .board')".into()]);
    commands.extend([look("red-team"), shot("red-team")]);
    page.drive(&commands)?;
    println!("pictures: {PICTURES}/*.webp");
    Ok(())
}
