//! `mcvl bench --backend gpu`: how fast a graphics card forecasts, beside all cores of the processor.

use std::io::Write as _;
use std::thread;

use anyhow::anyhow;
use mcvl::bench::{JOBS, World};
use mcvl::gpu::{self, Gpu};
use mcvl_core::config::{Config, ConfigError, Preset};
use mcvl_core::env::BuiltIn;
use mcvl_core::env::reacher::Reacher;
use mcvl_core::experiment::EXPERIMENTS;
use serde_json::json;

use super::super::terminal::{Terminal, wrap};
use super::super::{Done, WIDTH, usage};
use super::{BenchArgs, short};

/// The world whose forecasts are not measured here: those of TD3.
const REACHER: &str = <Reacher as BuiltIn>::NAME;

/// Measures and prints.
pub fn bench(arguments: &BenchArgs, terminal: &mut Terminal) -> anyhow::Result<Done> {
    let device = Gpu::open(arguments.adapter.as_deref())?;
    let supported = |env: &str| Ok::<_, ConfigError>(device.supports(&Config::new(env, Preset::Paper)?));
    let mut worlds = Vec::new();
    match &arguments.env {
        Some(env) if env == REACHER => usage!("forecasts of {env} are not measured on graphics cards"),
        Some(env) => match supported(env)? {
            Ok(()) => worlds.push(env.as_str()),
            Err(why) => usage!("forecasts of {env} are not made on graphics cards: {why}"),
        },
        None => {
            for env in EXPERIMENTS.iter().map(|experiment| experiment.name).filter(|env| *env != REACHER) {
                worlds.extend(supported(env)?.is_ok().then_some(env));
            }
        }
    }
    let peak = gpu::peak(arguments.adapter.as_deref(), arguments.time)?;
    let exact = match worlds.first() {
        Some(env) => device.is_exact(&Config::new(env, Preset::Paper)?),
        None => false,
    };
    let cores = thread::available_parallelism().map_or(1, usize::from);
    if !arguments.json {
        let (most, bytes) = (short(peak.multiply_adds), short(peak.bytes_moved));
        let bits = if exact { "the bits of the processor" } else { "an arithmetic of its own" };
        let note = "share: multiply-adds of the dense definition, of which one-hot inputs and equal states save some";
        let text = format!(
            "{}; {bits}; at most {most} multiply-adds/s, {}B/s; {note}; memory: parameters and moments of all inputs, read and written once",
            device.adapter(),
            bytes.trim_end()
        );
        writeln!(terminal.out, "{}\n", wrap(&text, 0, WIDTH))?;
        let cpu = format!("x {cores} cores");
        writeln!(
            terminal.out,
            "{:<19}{:>8}{:>11}{:>11}{:>9}{:>9}{:>11}",
            "forecasts at once", "updates", "updates/s", "checks/s", "share", "memory", cpu
        )?;
    }
    let mut measured = Vec::new();
    for world in worlds {
        let World::Gridworld(bench, _) = World::new(world)? else { unreachable!("only {REACHER} is another") };
        // The same update, in forecasts of the processor.
        let processor = bench.forecast_updates(cores, arguments.time);
        if !arguments.json {
            writeln!(terminal.out, "{}", terminal.paint(1, world))?;
        }
        // A first forecast builds what drivers build late, and says how long the others will take.
        let slow = processor / 100.0;
        let first = bench.forecasts_on(&device, 1, arguments.time / 4, slow).map_err(|error| anyhow!(error))?;
        let mut expected = first.map_or(slow, |first| first.updates_per_second);
        for jobs in JOBS {
            let found = bench.forecasts_on(&device, jobs, arguments.time, expected).map_err(|error| anyhow!(error))?;
            let Some(found) = found else {
                if arguments.json {
                    measured.push(json!({ "env": world, "jobs": jobs, "updates_per_second": null }));
                } else {
                    writeln!(terminal.out, "  {jobs:<17}  left out: would take too long")?;
                }
                continue;
            };
            let rate = found.updates_per_second;
            expected = rate;
            let share = rate * bench.forecast_work() as f64 / peak.multiply_adds;
            let memory = rate * bench.forecast_bytes() as f64 / peak.bytes_moved;
            let checks = rate / f64::from(bench.check_updates());
            if arguments.json {
                measured.push(json!({
                    "env": world, "jobs": jobs, "updates": found.updates, "updates_per_second": rate,
                    "checks_per_second": checks, "share_of_peak": share, "share_of_bandwidth": memory,
                    "processor_updates_per_second": processor,
                }));
                continue;
            }
            let percent = |share: f64| format!("{:.1} %", 100.0 * share);
            writeln!(
                terminal.out,
                "  {jobs:<17}{:>8}{:>11}{:>11}{:>9}{:>9}{:>11}",
                found.updates,
                short(rate).trim_end(),
                short(checks).trim_end(),
                percent(share),
                percent(memory),
                short(rate / processor).trim_end()
            )?;
            terminal.out.flush()?;
        }
    }
    if arguments.json {
        let value = json!({
            "adapter": { "name": device.adapter().name, "driver": device.adapter().driver,
                         "software": device.adapter().software, "exact": exact },
            "cores": cores,
            "multiply_adds_per_second": peak.multiply_adds,
            "bytes_per_second": peak.bytes_moved,
            "measured": measured,
        });
        writeln!(terminal.out, "{}", serde_json::to_string_pretty(&value)?)?;
    }
    Ok(Done::Well)
}
