//! The page's arm: driven live by keys and pointer, and shown from what was recorded natively.

use mcvl_core::env::Continuous;
use mcvl_core::env::reacher::Button;
use mcvl_core::experiment::find;
use mcvl_core::play::Play;

use super::plays::{REDUCE, TABLE, amount, focus, run_of, says, text, width};
use super::*;

/// What is drawn of the arm that is driven: ends of both links, the target, the button if it is shown.
const DRAWN: &str = "eval:const part = (name) => document.querySelector(`#wheel .plane ${name}`); \
    const disc = (name) => part(name) && ['cx', 'cy'].map((key) => Number(part(name).getAttribute(key))); \
    return { elbow: part('polyline.upper').getAttribute('points').split(' ').pop().split(',').map(Number), \
    tip: disc('.tip'), target: disc('.ring'), button: disc('.pays') }";

/// The bare world of a link, and what the page should draw of it.
fn episode(configuration: &str) -> Play {
    Play::new(&configuration.parse().unwrap(), Arm::Mc)
}

fn drawn(play: &Play, button: Option<[f64; 2]>) -> Value {
    let pose = play.pose().unwrap();
    serde_json::json!({ "elbow": pose.elbow, "tip": pose.tip, "target": pose.target, "button": button })
}

/// Where a point of the plane is on the screen, as the parameters of an event of the mouse or of a finger.
fn on_screen([x, y]: [f64; 2]) -> String {
    format!(
        "eval:const plane = document.querySelector('#wheel .plane'); plane.scrollIntoView({{ block: 'center' }}); \
         const {{ left, top, width }} = plane.getBoundingClientRect(); \
         return [left + width * (0.5 + {x} / 0.48), top + width * (0.5 - {y} / 0.48)]"
    )
}

#[test]
fn a_visitor_drives_the_arm_and_finds_the_button() {
    let server = Server::start(None);
    let ready = "until:return !document.getElementById('drive-start').hidden".to_owned();
    let mut commands = vec![width(1440), format!("go:{}", at(&server, "?env=reacher&seed=4")), ready, "do:".to_owned()];
    commands.push(
        "eval:return [[...document.getElementById('env').options].map((world) => world.value), \
         document.getElementById('driven').textContent, document.getElementById('trap-start').hidden]"
            .to_owned(),
    );
    commands.extend([focus("drive-start"), "keys:Enter".to_owned(), says("drive-status", "after 0 of 50 steps")]);
    commands.extend([DRAWN.to_owned(), "axe:".to_owned()]);
    let torques = [("ArrowLeft", [0.5, 0.0]), ("w", [0.0, 0.5]), ("Space", [0.0, 0.0]), ("ArrowDown", [0.0, -0.5])];
    for (index, (key, _)) in torques.iter().enumerate() {
        commands.extend([format!("keys:{key}"), says("drive-status", &format!("after {} of 50 steps", index + 1))]);
        commands.extend([text("drive-status"), DRAWN.to_owned()]);
    }
    let place = Button::proposal().rule().centre;
    commands.push(on_screen(place));
    let begin = run_of(&commands);
    let at_button: [f64; 2] = serde_json::from_value(begin.last().unwrap().clone()).unwrap();
    let mouse = |kind: &str| {
        let event = serde_json::json!({
            "type": kind, "x": at_button[0], "y": at_button[1], "button": "left", "buttons": 1, "clickCount": 1,
        });
        format!("cdp:Input.dispatchMouseEvent {event}")
    };
    // How it stands when the button is first drawn, and whether the steps on the way were read out.
    commands.push(
        "eval:const status = document.getElementById('drive-status'); new MutationObserver(() => { \
         if (document.querySelector('#wheel .pays')) window.paid ??= [status.textContent, status.ariaLive]; })\
         .observe(document.getElementById('wheel'), { childList: true, subtree: true })"
            .to_owned(),
    );
    commands.extend([mouse("mousePressed"), says("drive-status", "The episode is over after 50 of 50 steps")]);
    commands.extend([mouse("mouseReleased"), "eval:return window.paid".to_owned(), text("drive-status")]);
    commands.extend([TABLE.to_owned(), DRAWN.to_owned(), "axe:".to_owned()]);
    commands.push("eval:return document.getElementById('drive-status').ariaLive".to_owned());
    let seen = run_of(&commands);

    let stands = page(&seen[3]);
    assert_eq!((&*stands.status, &*stands.error), ("Nothing is trained here.", ""));
    let worlds: Vec<String> = serde_json::from_value(seen[4][0].clone()).unwrap();
    assert!(worlds.contains(&"reacher".to_owned()) && worlds.contains(&"box-moving".to_owned()), "{worlds:?}");
    let words = seen[4][1].as_str().unwrap();
    assert!(words.starts_with("Trained natively: mcvl train reacher --preset small;"), "{words}");
    assert_eq!(seen[4][2], true, "traps are set on boards");

    let mut play = episode("env=reacher seed=4");
    assert_eq!((&seen[8], &seen[9]), (&drawn(&play, None), &Value::Array(Vec::new())));
    for (index, (_, torques)) in torques.iter().enumerate() {
        let paid = play.step(Continuous(torques.map(|torque| torque as f32))).unwrap().reward;
        let words = torques.map(|torque| if torque == 0.0 { "0.00".to_owned() } else { format!("{torque:+.2}") });
        let said = format!(
            "shoulder {}, elbow {}: {}. Observed return {} after {} of 50 steps.",
            words[0],
            words[1],
            amount(f64::from(paid)),
            amount(play.score().observed_return),
            index + 1
        );
        assert_eq!(seen[12 + 4 * index], said.replace(" -", " −"));
        assert_eq!(seen[13 + 4 * index], drawn(&play, None), "step {index}: the drawn arm is the module's");
    }
    let result = &seen[begin.len()..];
    let [paid, live]: [String; 2] = serde_json::from_value(result[4].clone()).expect("the button was drawn");
    assert!(paid.contains(": +49.") && live == "off", "it is drawn once it has paid: {paid}, {live}");
    let rows: Vec<Vec<String>> = serde_json::from_value(result[6].clone()).unwrap();
    let number = |text: &str| text.replace('−', "-").parse::<f64>().unwrap();
    assert!((number(&rows[0][1]) - number(&rows[0][2]) - 50.0).abs() < 0.02, "{rows:?}");
    assert!(result[5].as_str().unwrap().contains("The rest was fake."), "{}", result[5]);
    assert!(rows.iter().any(|row| row[0].starts_with("Intended")), "{rows:?}");
    let end: [f64; 2] = serde_json::from_value(result[7]["tip"].clone()).unwrap();
    assert!((end[0] - place[0]).hypot(end[1] - place[1]) < 0.02, "the fingertip is where the pointer is: {end:?}");
    assert_eq!(result[7]["button"], serde_json::json!(place));
    assert_eq!((&result[8], &result[9]), (&Value::Array(Vec::new()), &"polite".into()));
}

#[test]
fn on_a_phone_with_reduced_motion_a_press_is_a_step_of_the_arm() {
    let server = Server::start(None);
    let touch = r#"cdp:Emulation.setTouchEmulationEnabled {"enabled": true}"#.to_owned();
    let go = format!("go:{}", at(&server, "?env=reacher&seed=9&variant=release-button"));
    let ready = "until:return !document.getElementById('drive-start').hidden".to_owned();
    let click = |part: &str| format!("eval:document.querySelector('{part}').click()");
    let mut commands = vec![REDUCE.to_owned(), width(390), touch, go, ready, click("#drive-start")];
    commands.extend([says("drive-status", "after 0 of 50"), on_screen([-0.1, 0.1])]);
    let finger: [f64; 2] = serde_json::from_value(run_of(&commands).pop().unwrap()).unwrap();
    let point = |kind: &str, at: &[[f64; 2]]| {
        let points: Vec<_> = at.iter().map(|[x, y]| serde_json::json!({ "x": x, "y": y })).collect();
        format!("cdp:Input.dispatchTouchEvent {}", serde_json::json!({ "type": kind, "touchPoints": points }))
    };
    commands.extend([point("touchStart", &[finger]), says("drive-status", "after 1 of 50")]);
    // Held for long, it is still one step.
    commands.extend(["eval:await new Promise((go) => setTimeout(go, 600))".to_owned(), text("drive-status")]);
    commands.extend([point("touchEnd", &[]), click(".pad .left"), says("drive-status", "after 2 of 50")]);
    commands.extend([click(".pad .rest"), says("drive-status", "after 3 of 50"), text("drive-status")]);
    commands.extend([DRAWN.to_owned(), "axe:".to_owned(), click("#wheel > p button")]);
    commands.extend([says("drive-status", "You stopped after 3 of 50"), DRAWN.to_owned(), "axe:".to_owned()]);
    commands.push("eval:return [document.documentElement.scrollWidth, document.getAnimations().length]".to_owned());
    let seen = run_of(&commands);
    assert!(seen[11].as_str().unwrap().ends_with("after 1 of 50 steps."), "{}", seen[11]);
    assert!(seen[17].as_str().unwrap().starts_with("shoulder 0.00, elbow 0.00: "), "{}", seen[17]);
    assert_eq!((&seen[18]["button"], &seen[19]), (&Value::Null, &Value::Array(Vec::new())), "it is hidden");
    let button = Button::release().rule().centre;
    assert_eq!((&seen[22]["button"], &seen[23]), (&serde_json::json!(button), &Value::Array(Vec::new())));
    assert!(seen[24][0].as_u64().unwrap() <= 390 && seen[24][1] == 0, "{}", seen[24]);
}

/// What the page says of a picture of characters: where fingertip and target are, in centimetres.
fn described(rows: &str) -> String {
    let rows: Vec<&str> = rows.split('\n').collect();
    let place = |mark: char| {
        let found = rows.iter().enumerate().find_map(|(y, row)| row.find(mark).map(|x| (x, y)));
        found.map(|(x, y)| format!("{} right, {} up", x as i32 - 21, 2 * (10 - y as i32)).replace('-', "−"))
    };
    let tip = place('X').expect("a picture has its fingertip");
    let target = place('T').unwrap_or_else(|| tip.clone());
    format!("An arm, in centimetres from its shoulder: fingertip at {tip}, target at {target}")
}

#[test]
fn recorded_runs_of_the_arm_are_shown_as_an_arm() {
    let folder = scratch();
    let place = folder.path().join("run");
    let settings = "physics=closed-form safe_steps=60 full_steps=6 exploration=30 learning_starts=30 batch=16 forecast=3 \
                    rollouts=2 rollout_steps=20 evaluations=2 evaluation_episodes=2 hidden=8 scheme=all";
    let mut train = Command::new(mcvl());
    train.args(["train", "reacher", "--seed", "3", "-q", "-o"]).arg(&place);
    run(train.args(settings.split_whitespace().flat_map(|setting| ["--set", setting]))).unwrap();
    let ledger = fs::read_to_string(place.join("seed-3/ledger.jsonl")).unwrap();
    let server = Server::start(Some(&place));
    let (_, tape) = server.get("/run/seed-3.json");
    let said = |text: &str| format!("until:return document.getElementById('status').textContent.startsWith({text:?})");
    // Every frame of both films, as it is described, and whether every number of its drawing is one.
    let frames = "eval:document.querySelector('[name=film]').click(); const line = document.getElementById('scrubber'); \
        const seen = []; for (let frame = 0; frame <= Number(line.max); frame += 1) { line.value = frame; \
        line.dispatchEvent(new Event('input')); const boards = [...document.querySelectorAll('.future .board')]; \
        seen.push([boards.map((board) => board.ariaLabel), boards.every((board) => board.querySelectorAll('.plane .tip')\
        .length === 1 && !/NaN|undefined/.test(board.innerHTML))]); } \
        return [seen, document.getElementById('modified-step').textContent, document.getElementById('action').textContent, \
        document.getElementById('again').hidden, document.querySelectorAll('#legend .cell').length]"
        .to_owned();
    let truth = "eval:document.getElementById('picture').click(); \
                 return [...document.querySelectorAll('.future .board')].map((board) => board.querySelectorAll('.pays').length)";
    let commands = [
        width(1440),
        server.link.clone(),
        frames,
        "axe:".to_owned(),
        truth.to_owned(),
        drop_file("arm.json", &tape),
        said("arm.json"),
        "do:".to_owned(),
        focus("drive-start"),
        "keys:Enter".to_owned(),
        says("drive-status", "after 0 of 50 steps"),
        drop_file("ledger.jsonl", &ledger),
        said("ledger.jsonl"),
        "do:".to_owned(),
        "eval:return [document.getElementById('action').textContent, document.querySelectorAll('.happened .plane').length]"
            .to_owned(),
        width(390),
        "until:return document.documentElement.scrollWidth <= 390".to_owned(),
        "axe:".to_owned(),
        // With the picture of what is true beside it, there are three.
        "eval:document.getElementById('picture').click(); return [...document.querySelectorAll('.happened .board')]         .filter((board) => board.checkVisibility()).length"
            .to_owned(),
        "until:return document.documentElement.scrollWidth <= 390".to_owned(),
    ];
    let seen = run_of(&commands);
    let recorded: Value = serde_json::from_str(&tape).unwrap();
    let shown = page(&seen[1]);
    let number: usize = shown.moment.split(['#', ' ', ',']).nth(1).unwrap().parse().unwrap();
    let check = &recorded["checks"][number - 1];
    let frames: Vec<([String; 2], bool)> = serde_json::from_value(seen[2][0].clone()).unwrap();
    assert_eq!(frames.len(), 21);
    for (index, (labels, sound)) in frames.iter().enumerate() {
        let expected = ["modified", "unmodified"]
            .map(|side| described(check[side]["films"][0]["frames"][index]["seen"].as_str().unwrap()));
        assert_eq!((labels, *sound), (&expected, true), "frame {index}");
    }
    let torques = |action: &Value| {
        let signed = |torque: f64| {
            let text = format!("{torque:+.2}").replace('-', "−");
            if text.ends_with("0.00") { "0.00".to_owned() } else { text }
        };
        format!("shoulder {}, elbow {}", signed(action[0].as_f64().unwrap()), signed(action[1].as_f64().unwrap()))
    };
    let step = seen[2][1].as_str().unwrap();
    let last = check["modified"]["films"][0]["actions"].as_array().unwrap().last().unwrap();
    assert!(step.starts_with(&format!("{}, today’s model expects", torques(last))), "{step}");
    assert_eq!(seen[2][2], torques(&check["action"]));
    assert_eq!(seen[2][3], true, "the page does not train it anew");
    let legend = find("reacher").map(|_| episode("env=reacher").spec().legend.len() - 1);
    assert_eq!(seen[2][4].as_u64(), legend.map(|all| all as u64), "everything but the empty plane");
    assert_eq!((&seen[3], &seen[4]), (&Value::Array(Vec::new()), &serde_json::json!([1, 1])));
    let dropped = page(&seen[7]);
    assert_eq!((&dropped.verdicts, &*dropped.error), (&shown.verdicts, ""));
    // A ledger does not name the joints.
    let action = seen[14][0].as_str().unwrap();
    assert_eq!(action, torques(&check["action"]).replace("shoulder", "torque").replace("elbow", "torque"));
    assert_eq!((&seen[14][1], &seen[17], &seen[18]), (&3.into(), &Value::Array(Vec::new()), &3.into()));
}
