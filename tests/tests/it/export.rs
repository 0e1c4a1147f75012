//! `mcvl export`: what other tools read is what the run holds.

use std::fs;
use std::path::Path;

use serde_json::Value;

use mcvl_tests::root;

use crate::cli::{ask, content, finished, json, lines, ok};

/// Events of one kind and leg in the log of a seed.
fn events(seed: &Path, kind: &str, arm: &str) -> Vec<Value> {
    let events = lines(&seed.join("metrics.jsonl")).into_iter().map(|line| json(&line));
    events.filter(|event| event["kind"] == kind && event["arm"] == arm).collect()
}

#[test]
fn tables_have_a_row_for_every_record() {
    let folder = finished();
    let folder = folder.path();
    let paths = ok(folder, "export run --to csv");
    let names = ["evaluations", "learner", "episodes", "checks"];
    assert_eq!(paths, names.map(|name| format!("run/export/csv/{name}.csv\n")).concat());
    for (name, kind) in [("evaluations", "evaluation"), ("learner", "learner"), ("episodes", "episode")] {
        let table = lines(&folder.join(format!("run/export/csv/{name}.csv")));
        let columns: Vec<&str> = table[0].split(',').collect();
        assert_eq!(columns[..3], ["seed", "arm", "step"]);
        let mut rows = table[1..].iter();
        for seed in ["0", "3"] {
            for arm in ["safe", "baseline", "mc"] {
                for event in events(&folder.join(format!("run/seed-{seed}")), kind, arm) {
                    let cells: Vec<&str> = rows.next().expect("a row for every record").split(',').collect();
                    assert_eq!((cells.len(), cells[0]), (columns.len(), seed));
                    for (column, cell) in columns.iter().zip(&cells).skip(1) {
                        let expected = &event[*column];
                        match expected.as_f64() {
                            Some(number) => assert_eq!(cell.parse::<f64>().unwrap() as f32, number as f32, "{column}"),
                            None => assert_eq!(*cell, expected.to_string().trim_matches('"'), "{column}"),
                        }
                    }
                }
            }
        }
        assert_eq!(rows.next(), None, "{name}");
    }
    let checks = lines(&folder.join("run/export/csv/checks.csv"));
    let list = json(&ok(folder, "ledger run --json"));
    assert_eq!(checks.len() - 1, list.as_array().unwrap().len());
    let cell = |row: &str, column: &str| {
        let at = checks[0].split(',').position(|name| name == column).unwrap_or_else(|| panic!("{column}"));
        row.split(',').nth(at).unwrap().to_owned()
    };
    for (row, check) in checks[1..].iter().zip(list.as_array().unwrap()) {
        for (column, expected) in [
            ("seed", &check["seed"]),
            ("check", &check["number"]),
            ("step", &check["step"]),
            ("utility_with", &check["modified"]["utility"]),
            ("performance_without", &check["unmodified"]["performance"]),
            ("margin", &check["margin"]),
            // Numbers of 32 bits have the same digits here and there.
            ("reward", &check["reward"]),
            ("predicted", &check["predicted"]),
            ("threshold", &check["threshold"]),
            ("hack", &check["hack"]),
            ("verdict", &check["verdict"]),
        ] {
            let cell = cell(row, column);
            match expected.as_f64() {
                Some(number) => assert_eq!(cell.parse::<f64>().unwrap().to_bits(), number.to_bits(), "{column}"),
                None => assert_eq!(cell, expected.to_string().trim_matches('"'), "{column}"),
            }
        }
        let right = (check["verdict"] == "refuse") == check["hack"].as_bool().unwrap();
        assert_eq!(cell(row, "wrong"), (!right).to_string());
    }
}

/// CRC-32C bit by bit, from its definition: reflected, polynomial 0x1edc6f41.
fn checksum(bytes: &[u8]) -> u32 {
    let mut remainder = !0u32;
    for byte in bytes {
        remainder ^= u32::from(*byte);
        for _ in 0..8 {
            let bit = remainder & 1;
            remainder >>= 1;
            if bit == 1 {
                remainder ^= 0x1edc_6f41u32.reverse_bits();
            }
        }
    }
    !remainder
}

/// Data of the records of an event file; every checksum has to fit.
fn records(mut file: &[u8]) -> Vec<&[u8]> {
    fn take<'a>(file: &mut &'a [u8], count: usize) -> &'a [u8] {
        let (head, rest) = file.split_at(count);
        *file = rest;
        head
    }
    fn checked<'a>(file: &mut &'a [u8], count: usize) -> &'a [u8] {
        let data = take(file, count);
        let sum = checksum(data);
        let masked = sum.rotate_right(15).wrapping_add(0xa282_ead8);
        assert_eq!(take(file, 4), masked.to_le_bytes());
        data
    }
    let mut records = Vec::new();
    while !file.is_empty() {
        let length = u64::from_le_bytes(checked(&mut file, 8).try_into().unwrap());
        records.push(checked(&mut file, length as usize));
    }
    records
}

/// The fields of a protocol-buffers message: number and bytes, those of a varint as a number.
fn fields(mut message: &[u8]) -> Vec<(u64, Vec<u8>)> {
    fn varint(message: &mut &[u8]) -> u64 {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let byte = message[0];
            *message = &message[1..];
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                break;
            }
        }
        value
    }
    let mut fields = Vec::new();
    while !message.is_empty() {
        let key = varint(&mut message);
        let length = match key & 7 {
            0 => {
                fields.push((key >> 3, varint(&mut message).to_le_bytes().to_vec()));
                continue;
            }
            1 => 8,
            2 => varint(&mut message) as usize,
            5 => 4,
            kind => panic!("kind {kind}"),
        };
        let (value, rest) = message.split_at(length);
        fields.push((key >> 3, value.to_vec()));
        message = rest;
    }
    fields
}

fn field(fields: &[(u64, Vec<u8>)], number: u64) -> &[u8] {
    let found = fields.iter().find(|(found, _)| *found == number);
    &found.unwrap_or_else(|| panic!("no field {number}")).1
}

/// Every (step, tag, value) of an event file.
fn scalars(file: &[u8]) -> Vec<(u64, String, f32)> {
    let records = records(file);
    let mut scalars = Vec::new();
    for (index, record) in records.iter().enumerate() {
        let event = fields(record);
        let time = f64::from_le_bytes(field(&event, 1).try_into().unwrap());
        assert!(time > 1.6e9, "the time is in seconds since 1970: {time}");
        if index == 0 {
            assert_eq!(field(&event, 3), b"brain.Event:2");
            continue;
        }
        let step = u64::from_le_bytes(field(&event, 2).try_into().unwrap());
        for (number, value) in fields(field(&event, 5)) {
            assert_eq!(number, 1);
            let value = fields(&value);
            let tag = String::from_utf8(field(&value, 1).to_vec()).unwrap();
            scalars.push((step, tag, f32::from_le_bytes(field(&value, 2).try_into().unwrap())));
        }
    }
    scalars
}

#[test]
fn event_files_hold_the_curves_of_every_leg() {
    let folder = finished();
    let folder = folder.path();
    let paths = ok(folder, "export run --to tensorboard -o board");
    assert_eq!(paths.lines().count(), 6, "{paths}");
    for seed in [0, 3] {
        for arm in ["safe", "baseline", "mc"] {
            let dir = folder.join(format!("run/seed-{seed}"));
            let file = folder.join(format!("board/seed-{seed}/{arm}/events.out.tfevents.mcvl"));
            let scalars = scalars(&fs::read(&file).unwrap());
            assert!(scalars.is_sorted_by_key(|(step, _, _)| *step));
            let curve = |tag: &str| -> Vec<(u64, f32)> {
                scalars.iter().filter(|(_, found, _)| found == tag).map(|(step, _, value)| (*step, *value)).collect()
            };
            for (tag, kind, name) in [
                ("evaluation/return", "evaluation", "return"),
                ("evaluation/performance", "evaluation", "performance"),
                ("evaluation/length", "evaluation", "length"),
                ("learner/epsilon", "learner", "epsilon"),
                ("learner/value_loss", "learner", "value_loss"),
                ("learner/reward_loss", "learner", "reward_loss"),
                ("episode/return", "episode", "return"),
                ("episode/performance", "episode", "performance"),
            ] {
                let recorded = events(&dir, kind, arm);
                let expected: Vec<(u64, f32)> = recorded
                    .iter()
                    .map(|event| (event["step"].as_u64().unwrap(), event[name].as_f64().unwrap() as f32))
                    .collect();
                assert!(!expected.is_empty());
                assert_eq!(curve(tag), expected, "{tag} of {arm}, seed {seed}");
            }
            let ledger: Vec<Value> = lines(&dir.join("ledger.jsonl")).iter().map(|line| json(line)).collect();
            let (checks, refusals) = match arm {
                "mc" => (ledger.len(), ledger.iter().filter(|line| line["verdict"] == "refuse").count()),
                _ => (0, 0),
            };
            assert_eq!(curve("check/checks").last(), Some(&(300, checks as f32)));
            assert_eq!(curve("check/refusals").last(), Some(&(300, refusals as f32)));
            assert_eq!(curve("check/margin").len(), checks);
        }
    }
}

#[test]
fn tapes_hold_the_checks_that_were_asked_for() {
    let folder = finished();
    let folder = folder.path();
    assert_eq!(ok(folder, "export run --to tape"), "run/export/tape/seed-0.json\nrun/export/tape/seed-3.json\n");
    let read = |name: &str| json(&fs::read_to_string(folder.join(name)).unwrap());
    let whole = read("run/export/tape/seed-3.json");
    assert_eq!(whole["checks"].as_array().unwrap().len(), lines(&folder.join("run/seed-3/ledger.jsonl")).len());
    // All there was to learn until the last of its checks, by both learners from the switch on.
    let safe = events(&folder.join("run/seed-3"), "end", "safe")[0]["updates"].as_u64().unwrap();
    let price = |checks: &[Value]| {
        let costs = checks.iter().map(|check| check["cost"].as_u64().unwrap());
        costs.sum::<u64>() + 2 * checks.last().unwrap()["updates"].as_u64().unwrap() - safe
    };
    let checks = whole["checks"].as_array().unwrap();
    assert_eq!(whole["updates"], price(checks), "what deriving it again costs");
    assert_eq!(ok(folder, "export run/seed-3 --to tape --check 2 --check 1 -o two.json"), "two.json\n");
    let mut two = read("two.json");
    assert_eq!(two["checks"].as_array().unwrap()[..], checks[..2]);
    assert_eq!(two["updates"], price(&checks[..2]));
    assert!(two["checks"][0]["modified"]["films"].is_array());
    for key in ["checks", "updates"] {
        two[key] = whole[key].clone();
    }
    assert_eq!(two, whole, "all else is the same");
    // Something.json that is a folder takes a file like any other.
    fs::create_dir(folder.join("folder.json")).unwrap();
    assert_eq!(ok(folder, "export run --to tape --seed 0 -o folder.json"), "folder.json/seed-0.json\n");
}

#[test]
fn every_column_and_tag_is_told_in_the_documentation() {
    let folder = finished();
    let folder = folder.path();
    ok(folder, "export run --to csv --seed 3 -o tables");
    ok(folder, "export run --to tensorboard --seed 3 -o events");
    let told = fs::read_to_string(root().join("docs/export.md")).unwrap();
    let mut names = Vec::new();
    let logs = fs::read_to_string(folder.join("run/seed-3/steps.csv")).unwrap();
    let tables = content(&folder.join("tables")).into_values().map(|bytes| String::from_utf8(bytes).unwrap());
    for text in tables.chain([logs]) {
        names.extend(text.lines().next().unwrap().split(',').map(str::to_owned));
    }
    for (_, bytes) in content(&folder.join("events")) {
        names.extend(scalars(&bytes).into_iter().map(|(_, tag, _)| tag));
    }
    assert!(names.len() > 60, "{names:?}");
    for name in names {
        assert!(told.contains(&format!("`{name}`")), "docs/export.md does not tell `{name}`");
    }
    for world in json(&ok(folder, "envs --json")).as_array().unwrap() {
        let [title, layout] = ["title", "observation_layout"].map(|key| world[key].as_str().unwrap());
        let names: Vec<&str> = world["action_names"].as_array().unwrap().iter().filter_map(Value::as_str).collect();
        let row = format!("| {title} | {layout} | {} |", names.join(", "));
        assert!(told.contains(&row), "docs/export.md lacks {row}");
    }
}

#[test]
fn weights_are_exported_as_they_are() {
    let folder = finished();
    let folder = folder.path();
    ok(folder, "export run --to safetensors -o weights --seed 3");
    let exported = content(&folder.join("weights/seed-3"));
    assert_eq!(exported.len(), 3);
    for (name, bytes) in exported {
        assert!(bytes == fs::read(folder.join("run/seed-3/checkpoints").join(&name)).unwrap(), "{}", name.display());
    }
    let path = folder.join("run/seed-3/checkpoints/mc.safetensors");
    let whole = fs::read(&path).unwrap();
    // Tensors all the same, but others.
    let mut altered = whole.clone();
    altered[whole.len() - 400..].fill(0);
    for (bytes, why) in
        [(&whole[..whole.len() / 2], "cut off or altered"), (&altered[..], "altered: its digest is not")]
    {
        fs::write(&path, bytes).unwrap();
        let answer = ask(folder, "export run --to safetensors -o other");
        assert_eq!(answer.code, 3, "{}", answer.stderr);
        assert!(answer.stderr.contains(&format!("seed-3/checkpoints/mc.safetensors: {why}")), "{}", answer.stderr);
        assert!(!folder.join("other").exists(), "nothing is written before all is read");
    }
}

#[test]
fn exports_are_replaced_only_on_request_and_go_with_their_run() {
    let folder = finished();
    let folder = folder.path();
    ok(folder, "export run --to csv");
    let table = folder.join("run/export/csv/checks.csv");
    fs::remove_file(folder.join("run/export/csv/evaluations.csv")).unwrap();
    fs::write(&table, "mine").unwrap();
    let answer = ask(folder, "export run --to csv");
    assert_eq!(answer.code, 2);
    let expected = "run/export/csv/learner.csv is there already: --overwrite replaces it, -o writes elsewhere";
    assert!(answer.stderr.contains(expected), "{}", answer.stderr);
    assert_eq!(fs::read_to_string(&table).unwrap(), "mine");
    assert!(!folder.join("run/export/csv/evaluations.csv").exists(), "some files and not others help nobody");
    ok(folder, "export run --to csv --overwrite");
    assert!(fs::read_to_string(&table).unwrap().starts_with("seed,arm,check,"));
    // An export is no part of what the manifest vouches for, and is of no use without its run.
    assert!(ok(folder, "verify run").contains("run is intact"));
    ok(folder, "train box-moving --quick -o run --overwrite");
    assert!(!folder.join("run/export").exists());
}

#[test]
fn an_unfinished_run_is_exported_as_far_as_it_is() {
    let folder = finished();
    let folder = folder.path();
    let stopped = ask(folder, "train box-moving --seeds 0..400 --max-time 1s -q -o open");
    assert_eq!(stopped.code, 130, "{}", stopped.stderr);
    ok(folder, "export open --to csv");
    let rows = lines(&folder.join("open/export/csv/evaluations.csv"));
    assert!(rows.len() > 1 && rows[1].starts_with("0,safe,0,"), "{rows:?}");
    ok(folder, "export open --to tensorboard");
}
