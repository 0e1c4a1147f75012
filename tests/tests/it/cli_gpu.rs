//! Forecasts on a graphics card, as the command line offers them; on the software device where there is no card.

use mcvl_tests::scratch;

use crate::cli::{ask, assert_same, json, ok};

/// A run whose futures are small, since software devices are slow.
const TRAIN: &str = "train box-moving --quick --seeds 0,2 --set full_steps=60 --set hidden=32 --set forecast=60";

/// The adapter that is taken without `--adapter`. Says so where there is none, or fails where one is required.
fn adapter() -> Option<(String, bool)> {
    let folder = scratch();
    let about = json(&ok(folder.path(), "doctor --json"));
    let first = &about["adapters"]["found"][0];
    let Some(name) = first["name"].as_str() else {
        let required = std::env::var_os("MCVL_REQUIRE_GPU").is_some();
        assert!(!required, "MCVL_REQUIRE_GPU is set: {}", about["adapters"]);
        eprintln!("skipped: no adapter");
        return None;
    };
    Some((name.to_owned(), first["software"] == true))
}

#[test]
fn a_card_gives_the_verdicts_of_the_processor() {
    let Some((name, software)) = adapter() else { return };
    let folder = scratch();
    let folder = folder.path();
    ok(folder, &format!("{TRAIN} -o cpu"));
    ok(folder, &format!("{TRAIN} -o gpu --backend gpu"));
    let manifest = json(&std::fs::read_to_string(folder.join("gpu/manifest.json")).unwrap());
    assert!(manifest["forecasts"][0].as_str().unwrap().contains(&name), "{manifest}");
    assert!(ok(folder, "verify gpu").contains("gpu is intact"));
    let exact = manifest["forecasts"][0].as_str().unwrap().ends_with("with the bits of the processor");
    assert!(exact || !software, "{manifest}");
    if exact {
        assert_same(&folder.join("gpu"), &folder.join("cpu"));
        // Decided there, derived again here.
        ok(folder, "replay gpu#1");
    }
    let verdicts = |run: &str| {
        let ledger = ok(folder, &format!("ledger {run} --json"));
        let verdict = |check: &serde_json::Value| (check["step"].clone(), check["verdict"].clone());
        let verdicts: Vec<_> = json(&ledger).as_array().unwrap().iter().map(verdict).collect();
        for wanted in ["accept", "refuse"] {
            assert!(verdicts.iter().filter(|(_, verdict)| verdict == wanted).count() > 3, "{ledger}");
        }
        verdicts
    };
    assert_eq!(verdicts("gpu"), verdicts("cpu"));
}

#[test]
fn a_run_changes_its_back_end_where_it_stopped() {
    if adapter().is_none() {
        return;
    }
    let folder = scratch();
    let folder = folder.path();
    let stopped = ask(folder, &format!("{TRAIN} -o run --backend gpu --max-time 1500ms"));
    // A fast card may be through before.
    if stopped.code == 130 {
        assert!(stopped.stderr.contains("--resume --backend gpu"), "{}", stopped.stderr);
        ok(folder, "train box-moving -o run --resume");
    }
    assert!(ok(folder, "verify run").contains("is intact"));
    let manifest = json(&std::fs::read_to_string(folder.join("run/manifest.json")).unwrap());
    if manifest["forecasts"][0].as_str().unwrap().ends_with("with the bits of the processor") {
        ok(folder, &format!("{TRAIN} -o cpu"));
        assert_same(&folder.join("run"), &folder.join("cpu"));
    }
}

#[test]
fn cells_that_forecast_on_a_card_train_side_by_side() {
    if adapter().is_none() {
        return;
    }
    let folder = scratch();
    let folder = folder.path();
    let cells = "reproduce E7 --seeds 0..1 --only box-safe-0 --only box-safe-100 -o set";
    let stopped = ask(folder, &format!("{cells} --backend gpu --max-time 5s"));
    // A fast card may be through before.
    if stopped.code == 130 {
        for cell in ["box-safe-0", "box-safe-100"] {
            assert!(folder.join("set/cells").join(cell).join("seed-0").is_dir(), "{cell}: {}", stopped.stderr);
            assert!(stopped.stderr.contains(&format!("{cell}: ")), "a line names the cell: {}", stopped.stderr);
        }
        assert!(
            stopped.stderr.contains("--only box-safe-0 --only box-safe-100 -o set --backend gpu"),
            "{}",
            stopped.stderr
        );
        ok(folder, cells);
    }
    for cell in ["box-safe-0", "box-safe-100"] {
        let record = json(&std::fs::read_to_string(folder.join(format!("set/records/{cell}.record.json"))).unwrap());
        assert_eq!(record["cell"], cell);
    }
}

#[test]
fn what_cannot_go_to_a_card_is_said() {
    let folder = scratch();
    let folder = folder.path();
    let alone = ask(folder, &format!("{TRAIN} --adapter llvmpipe -o run"));
    assert_eq!(alone.code, 2);
    assert!(alone.stderr.contains("--backend gpu"), "{}", alone.stderr);
    let unknown = ask(folder, &format!("{TRAIN} --backend gpu --adapter none-such -o run"));
    assert_eq!(unknown.code, 3);
    assert!(unknown.stderr.contains("none-such") || unknown.stderr.contains("no adapter"), "{}", unknown.stderr);
    assert!(!folder.join("run").exists(), "nothing is laid out before the device is open");
    let Some((_, software)) = adapter() else { return };
    let practising = ask(folder, "bench rocks-and-diamonds --backend gpu");
    assert_eq!(practising.code, 2);
    assert!(practising.stderr.contains("practise"), "{}", practising.stderr);
    let deep = ask(folder, &format!("{TRAIN} --set layers=3 --backend gpu -o deep"));
    assert_eq!(deep.code, 0, "{}", deep.stderr);
    assert!(deep.stderr.contains("forecasts on the processor") && deep.stderr.contains("layers"), "{}", deep.stderr);
    let manifest = json(&std::fs::read_to_string(folder.join("deep/manifest.json")).unwrap());
    assert!(manifest["forecasts"][0].as_str().unwrap().starts_with("processor"), "{manifest}");
    if software {
        let auto = ask(folder, &format!("{TRAIN} --backend auto -o auto"));
        assert_eq!(auto.code, 0, "{}", auto.stderr);
        assert!(auto.stderr.contains("is software"), "{}", auto.stderr);
    }
}
