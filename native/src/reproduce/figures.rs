//! Figures like the paper's 3, 4a, 4b and 5, from records: observed return on the left, performance on the
//! right, Safe training and the switch to Full in every panel, the optima as reference lines.

use std::collections::BTreeMap;

use mcvl_core::record::Arm;

use super::cells::*;
use super::record::Record;
use super::table::unique;
use crate::report::plot::{Figure, Horizontal, Panel, Point, Series, legend_of, look_of, name_of, references, unit_of};
use crate::report::statistics::Quantity;

/// A figure, before there are numbers.
pub struct Drawing {
    /// Name of its files.
    pub name: &'static str,
    /// Target of the command line that it belongs to.
    pub target: &'static str,
    /// Title.
    pub title: &'static str,
    rows: &'static [Rows],
}

/// Two panels side by side.
struct Rows {
    title: &'static str,
    /// The cell that gives the shared curves (Safe training, the plain learner) and the references.
    main: &'static Cell,
    /// Whether those are drawn: not where cells differ in their Safe training.
    shared: bool,
    /// Curves of the checking learner: cell, name, look.
    curves: &'static [(&'static Cell, &'static str, usize)],
}

const MC: &str = "modification-considering";

/// Every figure.
pub static DRAWINGS: &[Drawing] = &[
    Drawing {
        name: "fig3",
        target: "fig3",
        title: "Figure 3: DDQN and MC-DDQN in four worlds",
        rows: &[
            Rows { title: "(a) Box Moving", main: &BOX, shared: true, curves: &[(&BOX, MC, 2)] },
            Rows { title: "(b) Absent Supervisor", main: &ABSENT, shared: true, curves: &[(&ABSENT, MC, 2)] },
            Rows { title: "(c) Tomato Watering", main: &TOMATO, shared: true, curves: &[(&TOMATO, MC, 2)] },
            Rows { title: "(d) Rocks and Diamonds", main: &ROCKS, shared: true, curves: &[(&ROCKS, MC, 2)] },
        ],
    },
    Drawing {
        name: "fig3-alive",
        target: "fig3",
        title: "As Figure 3, with more of the reward model alive (rate 0.001)",
        rows: &[
            Rows { title: "Absent Supervisor", main: &ABSENT_ALIVE, shared: true, curves: &[(&ABSENT_ALIVE, MC, 2)] },
            Rows { title: "Tomato Watering", main: &TOMATO_ALIVE, shared: true, curves: &[(&TOMATO_ALIVE, MC, 2)] },
            Rows { title: "Rocks and Diamonds", main: &ROCKS_ALIVE, shared: true, curves: &[(&ROCKS_ALIVE, MC, 2)] },
        ],
    },
    Drawing {
        name: "fig3e",
        target: "fig3e",
        title: "Figure 3e: TD3 and MC-TD3 in Reacher, preset small",
        rows: &[Rows { title: "(e) Reacher", main: &REACHER, shared: true, curves: &[(&REACHER, MC, 2)] }],
    },
    Drawing {
        name: "fig4a",
        target: "fig4a",
        title: "Figure 4a: schemes in Box Moving",
        rows: &[Rows {
            title: "Box Moving",
            main: &BOX,
            shared: true,
            curves: &[
                (&BOX, "check by reward", 2),
                (&BOX_ALL, "check all", 3),
                (&BOX_DISCARD, "discard by reward", 4),
                (&BOX_EACH, "check each step", 5),
                (&BOX_PUNISH, "punish (-2)", 6),
                (&BOX_PREDICTED, "store predicted", 7),
            ],
        }],
    },
    Drawing {
        name: "fig4b",
        target: "fig4b",
        title: "Figure 4b: steps of Safe training in Box Moving",
        rows: &[Rows {
            title: "Box Moving",
            main: &BOX,
            shared: false,
            curves: &[
                (&BOX_SAFE_0, "0 Safe steps", 3),
                (&BOX_SAFE_100, "100 Safe steps", 4),
                (&BOX_SAFE_200, "200 Safe steps", 5),
                (&BOX_SAFE_300, "300 Safe steps", 6),
                (&BOX, "1000 Safe steps", 2),
            ],
        }],
    },
    Drawing {
        name: "fig5",
        target: "fig5",
        title: "Figure 5: forecast updates, no inconsistency, supervisors, walls",
        rows: &[
            Rows {
                title: "(a) Forecast updates l (paper: 500)",
                main: &BOX,
                shared: true,
                curves: &[(&BOX_L_100, "l = 100", 3), (&BOX_L_300, "l = 300", 4), (&BOX, MC, 2)],
            },
            Rows { title: "(b) No Inconsistency", main: &BOX_NO_INC, shared: true, curves: &[(&BOX_NO_INC, MC, 2)] },
            Rows {
                title: "(c) Supervisors",
                main: &ABSENT,
                shared: false,
                curves: &[
                    (&ABSENT, "1 cell", 2),
                    (&ABSENT_12, "12 cells", 5),
                    (&ABSENT_1_12, "12 cells, 1 in Safe", 6),
                ],
            },
            Rows { title: "(d) Walls removed", main: &ABSENT_WALLS, shared: true, curves: &[(&ABSENT_WALLS, MC, 2)] },
        ],
    },
    Drawing {
        name: "fig5-alive",
        target: "fig5",
        title: "As Figure 5c and d, with more of the reward model alive (rate 0.001)",
        rows: &[
            Rows {
                title: "Supervisors",
                main: &ABSENT_ALIVE,
                shared: false,
                curves: &[
                    (&ABSENT_ALIVE, "1 cell", 2),
                    (&ABSENT_12_ALIVE, "12 cells", 5),
                    (&ABSENT_1_12_ALIVE, "12 cells, 1 in Safe", 6),
                ],
            },
            Rows {
                title: "Walls removed",
                main: &ABSENT_WALLS_ALIVE,
                shared: true,
                curves: &[(&ABSENT_WALLS_ALIVE, MC, 2)],
            },
        ],
    },
];

impl Drawing {
    /// The cells that it shows.
    pub fn cells(&self) -> Vec<&'static Cell> {
        unique(self.rows.iter().flat_map(Rows::cells))
    }

    /// The figure, as far as there are records; none without any.
    pub fn draw(&self, records: &BTreeMap<String, Record>, quick: bool) -> Option<Figure> {
        let there = self.cells().into_iter().filter_map(|cell| records.get(cell.name));
        let seeds: Vec<usize> = there.map(|record| record.seeds().len()).collect();
        let (few, many) = (seeds.iter().min()?, seeds.iter().max()?);
        let count = if few == many { few.to_string() } else { format!("{few} to {many}") };
        let quick_note = if quick { "; quick, not the paper's setting" } else { "" };
        // Rows of which there is nothing yet are left out, and named.
        let (shown, open): (Vec<&Rows>, Vec<&Rows>) = self.rows.iter().partition(|rows| rows.has_some(records));
        let panels = shown.iter().flat_map(|rows| {
            [Quantity::Return, Quantity::Performance].map(|quantity| rows.panel(quantity, records, *many, quick))
        });
        let panels: Vec<Panel> = panels.collect();
        let open: Vec<&str> = open.iter().map(|rows| rows.title).collect();
        let open = if open.is_empty() { String::new() } else { format!("; not measured yet: {}", open.join(", ")) };
        Some(Figure {
            title: self.title.to_owned(),
            description: self.describe(records),
            note: format!("mean of {count} seeds, band: its 95 % interval{quick_note}{open}"),
            panels,
            columns: 2,
        })
    }

    fn describe(&self, records: &BTreeMap<String, Record>) -> String {
        let told = self.rows.iter().flat_map(|rows| {
            rows.curves.iter().filter_map(|(cell, name, _)| {
                let leg = records.get(cell.name)?.summary.as_ref()?.arm(Arm::Mc)?;
                let (observed, performance) = (leg.observed_return.mean, leg.performance.mean);
                Some(format!(
                    "{}, {name}: ends at observed return {observed:.1}, performance {performance:.1}.",
                    rows.title
                ))
            })
        });
        told.collect::<Vec<_>>().join(" ")
    }
}

impl Rows {
    /// The cells that it shows, some perhaps twice.
    fn cells(&self) -> impl Iterator<Item = &'static Cell> {
        std::iter::once(self.main).chain(self.curves.iter().map(|curve| curve.0))
    }

    /// Whether there is a curve of the checking learner.
    fn has_some(&self, records: &BTreeMap<String, Record>) -> bool {
        self.curves.iter().any(|(cell, ..)| records.contains_key(cell.name))
    }

    /// A panel of a figure whose records have up to `many` seeds: with fewer, it says so.
    fn panel(&self, quantity: Quantity, records: &BTreeMap<String, Record>, many: usize, quick: bool) -> Panel {
        let config = self.main.settings(quick).expect("the table is valid");
        let main = records.get(self.main.name);
        let line = |record: &Record, arm: Arm, name: &str, look: usize| {
            let from = if arm == Arm::Safe { -f64::from(safe_steps(record)) } else { 0.0 };
            let curve = record.arm(arm).map_or(&[][..], |arm| &arm.curve);
            let points = curve.iter().map(|point| {
                let [mean, low, high] = point.of(quantity);
                Point { x: from + f64::from(point.step), mean, low, high }
            });
            let (points, count) = (points.collect(), record.seeds().len());
            Series { name: name.to_owned(), leg: arm, look, count, points, seeds: Vec::new() }
        };
        let mut series = Vec::new();
        if self.shared {
            let arms = [Arm::Safe, Arm::Baseline].map(|arm| main.map(|r| line(r, arm, legend_of(arm), look_of(arm))));
            series.extend(arms.into_iter().flatten());
        }
        for (cell, name, look) in self.curves {
            let Some(record) = records.get(cell.name) else { continue };
            if !self.shared {
                // Each has a Safe training of its own, in its own look.
                series.push(line(record, Arm::Safe, name, *look));
            }
            series.push(line(record, Arm::Mc, name, *look));
        }
        series.retain(|series| !series.points.is_empty());
        let there = self.cells().filter_map(|cell| records.get(cell.name));
        let seeds: Vec<usize> = there.map(|record| record.seeds().len()).collect();
        let few = match (seeds.iter().min(), seeds.iter().max()) {
            (Some(few), Some(most)) if few < most => format!(", {few} to {most} seeds"),
            (Some(few), _) if *few < many => format!(", {few} seeds"),
            _ => String::new(),
        };
        Panel {
            title: format!("{}: {}{few}", self.title, name_of(quantity).to_lowercase()),
            y_title: unit_of(quantity).into(),
            x: Horizontal::Steps { title: "environment steps from the switch on".into(), switch: Some(0.0) },
            series,
            references: references(&config, quantity),
        }
    }
}

/// Steps of Safe training behind a record.
fn safe_steps(record: &Record) -> u32 {
    record.arm(Arm::Safe).and_then(|arm| arm.curve.last()).map_or(0, |point| point.step)
}

#[cfg(test)]
mod tests {
    use super::super::table::find;
    use super::*;
    use crate::report::samples;
    use crate::runs::Manifest;

    #[test]
    fn figures_are_drawn_from_what_is_there() {
        let record = Record::of_run(BOX.name, &samples::ten(), &Manifest::begin());
        let records: BTreeMap<_, _> = [(BOX.name.to_owned(), record)].into();
        for drawing in DRAWINGS {
            let figure = drawing.draw(&records, false);
            assert_eq!(figure.is_some(), drawing.cells().contains(&&BOX), "{}", drawing.name);
            assert_eq!(drawing.draw(&BTreeMap::new(), false), None);
        }
        let figure = DRAWINGS[0].draw(&records, false).unwrap();
        // Three worlds are not there yet.
        assert_eq!((figure.panels.len(), figure.columns), (2, 2));
        assert!(figure.note.ends_with("(c) Tomato Watering, (d) Rocks and Diamonds"), "{}", figure.note);
        let ends: Vec<_> =
            figure.panels[1].series.iter().map(|s| (s.points[0].x, s.points.last().unwrap().x)).collect();
        assert_eq!(ends, [(-1000.0, 0.0), (0.0, 1000.0), (0.0, 1000.0)]);
        assert_eq!(figure.svg(), DRAWINGS[0].draw(&records, false).unwrap().svg());
    }

    #[test]
    fn a_panel_with_few_seeds_says_so() {
        let record = Record::of_run(BOX.name, &samples::ten(), &Manifest::begin());
        let few = record.only(&record.seeds()[..2]).unwrap();
        let records: BTreeMap<_, _> = [(BOX.name.to_owned(), record), (TOMATO.name.to_owned(), few.clone())].into();
        let figure = DRAWINGS[0].draw(&records, false).unwrap();
        let titles: Vec<&str> = figure.panels.iter().map(|panel| panel.title.as_str()).collect();
        assert_eq!(titles[1], "(a) Box Moving: performance");
        assert_eq!(titles[3], "(c) Tomato Watering: performance, 2 seeds");
        assert!(figure.note.starts_with("mean of 2 to 10 seeds"), "{}", figure.note);
        // ... and where its curves have different numbers of them, the table says which has how many.
        let records = [(BOX.name.to_owned(), records[BOX.name].clone()), (BOX_SAFE_100.name.to_owned(), few)].into();
        let steps = DRAWINGS.iter().find(|drawing| drawing.name == "fig4b").unwrap();
        let figure = steps.draw(&records, false).unwrap();
        assert_eq!(figure.panels[0].title, "Box Moving: observed return, 2 to 10 seeds");
        let table = figure.csv();
        assert!(table.starts_with("panel,series,leg,seeds,x,mean,low,high\n"), "{table}");
        // The title of the panel has a comma.
        let series: Vec<_> = table.lines().map(|line| line.split(',').skip(2).take(3).collect::<Vec<_>>()).collect();
        for kind in [["100 Safe steps", "safe", "2"], ["100 Safe steps", "mc", "2"], ["1000 Safe steps", "mc", "10"]] {
            assert!(series.iter().any(|line| *line == kind), "{kind:?}: {table}");
        }
    }

    #[test]
    fn every_figure_is_a_target() {
        for drawing in DRAWINGS {
            let experiments = find(drawing.target);
            assert!(!experiments.is_empty(), "{}", drawing.name);
            let cells = unique(experiments.iter().flat_map(|experiment| experiment.cells()));
            assert!(drawing.cells().iter().all(|cell| cells.contains(cell)), "{}", drawing.name);
        }
    }
}
