//! `mcvl bench`: how fast this machine is.

mod gpu;

use std::io::Write as _;
use std::thread;
use std::time::Duration;

use clap::Args;
use mcvl::bench::{Rates, World, peak};
use mcvl::runs::Manifest;
use mcvl_core::experiment::EXPERIMENTS;
use serde_json::json;

use super::session::BackEnd;
use super::terminal::{Terminal, wrap};
use super::{Done, WIDTH, usage};

/// Arguments of `mcvl bench`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  mcvl bench
  mcvl bench rocks-and-diamonds --time 2s
  mcvl bench --json > this-machine.json
  mcvl bench --backend gpu

Shares are of the multiply-adds per second that the machine reaches at most
without fusing. They count the work of the dense definition: what one-hot
inputs and equal states save shows as speed, even beyond 100 %. What other
programs take of the cores is missing in the figures.

A rating is what a check does with each of its two futures: so many rollouts of
so many steps, equal ones once. What takes longer than the time per figure is
done twice, and the second time counts.")]
pub struct BenchArgs {
    /// Only this environment
    env: Option<String>,
    /// Time per figure
    #[arg(long, default_value = "300ms", value_name = "TIME", value_parser = humantime::parse_duration)]
    time: Duration,
    /// What is measured: every part of a run on the processor, or forecasts on a graphics card
    #[arg(long, value_enum, default_value_t = BackEnd::Cpu, value_name = "WHAT")]
    backend: BackEnd,
    /// Graphics card whose name contains this (see `mcvl doctor`)
    #[arg(long, value_name = "NAME")]
    adapter: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Measures and prints.
pub fn bench(arguments: &BenchArgs, terminal: &mut Terminal) -> anyhow::Result<Done> {
    match (arguments.backend, &arguments.adapter) {
        (BackEnd::Gpu, _) => return gpu::bench(arguments, terminal),
        (BackEnd::Auto, _) => usage!("--backend is cpu or gpu: name what is to be measured"),
        (BackEnd::Cpu, Some(_)) => usage!("--adapter names a graphics card: add --backend gpu"),
        (BackEnd::Cpu, None) => {}
    }
    let about = Manifest::begin();
    let cores = thread::available_parallelism().map_or(1, usize::from);
    let optimised = !cfg!(debug_assertions);
    if !optimised {
        terminal.note("note: built without optimisation, so these are not the figures of this machine");
    }
    let envs: Vec<&str> = match &arguments.env {
        Some(env) => vec![env],
        None => EXPERIMENTS.iter().map(|experiment| experiment.name).collect(),
    };
    let worlds = envs.iter().map(|env| World::new(env)).collect::<Result<Vec<_>, _>>()?;
    let peak = peak(cores, arguments.time);
    if !arguments.json {
        writeln!(terminal.out, "{}, {}", about.cpu, about.vector)?;
        let (one, all) = (short(peak.one), short(peak.all));
        let note = "shares of it count the work of the dense definition, of which some is saved (see --help)";
        let peaks = format!("peak: {one} multiply-adds/s on one core, {all} on {cores}, not fused; {note}");
        writeln!(terminal.out, "{}\n", wrap(&peaks, 0, WIDTH))?;
        let all = format!("on {cores}");
        writeln!(terminal.out, "{:<32}{:>9} {:>7}  {:>9} {:>7}", "per second", "one core", "peak", all, "peak")?;
    }
    let mut measured = Vec::new();
    for (env, world) in envs.iter().zip(&worlds) {
        if !arguments.json {
            writeln!(terminal.out, "{}", terminal.paint(1, env))?;
        }
        for case in world.cases() {
            let rates = case.rates(cores, arguments.time);
            let share = case
                .work
                .map(|work| Rates { one: rates.one * work as f64 / peak.one, all: rates.all * work as f64 / peak.all });
            if arguments.json {
                measured.push(json!({
                    "env": env,
                    "name": case.name,
                    "per_second": rates,
                    "multiply_adds": case.work,
                    "share_of_peak": share,
                }));
                continue;
            }
            let percent = |of: fn(&Rates) -> f64| share.map_or(String::new(), |s| format!("{:.0} %", 100.0 * of(&s)));
            let line = format!(
                "  {:<30}{:>9} {:>7}  {:>9} {:>7}",
                case.name,
                short(rates.one),
                percent(|s| s.one),
                short(rates.all),
                percent(|s| s.all)
            );
            writeln!(terminal.out, "{}", line.trim_end())?;
            // Each figure takes a while; whoever watches sees it as it comes.
            terminal.out.flush()?;
        }
    }
    if arguments.json {
        let value = json!({
            "version": about.version,
            "commit": about.commit,
            "compiler": about.compiler,
            "target": about.target,
            "optimised": optimised,
            "cpu": about.cpu,
            "vector": about.vector,
            "cores": cores,
            "multiply_adds_per_second": peak,
            "measured": measured,
        });
        writeln!(terminal.out, "{}", serde_json::to_string_pretty(&value)?)?;
    }
    Ok(Done::Well)
}

/// A rate with three digits: `41.2 k`.
fn short(rate: f64) -> String {
    let (value, unit) = match rate {
        rate if rate >= 1e9 => (rate / 1e9, " G"),
        rate if rate >= 1e6 => (rate / 1e6, " M"),
        rate if rate >= 1e3 => (rate / 1e3, " k"),
        rate => (rate, "  "),
    };
    let decimals = match value {
        value if value >= 99.95 => 0,
        value if value >= 9.995 => 1,
        value if value >= 0.0995 => 2,
        _ => 4,
    };
    format!("{value:.decimals$}{unit}")
}

#[cfg(test)]
mod tests {
    use super::short;

    #[test]
    fn rates_have_three_digits() {
        let texts = [0.831, 9.996, 41_234.0, 999.4, 1e6, 53.21e9].map(short);
        assert_eq!(texts, ["0.83  ", "10.0  ", "41.2 k", "999  ", "1.00 M", "53.2 G"]);
    }
}
