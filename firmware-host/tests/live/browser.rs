//! The page in a real browser.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use live_view::access::{Access, Transport};
use live_view::robot::Robot;
use live_view::server;
use rustix::process::Signal;
use tokio::net::TcpListener;

use super::devtools::Browser;
use super::explore::Explore;

/// Serves the page for a run, and returns its address.
async fn serve(run: &Explore) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let access = Access::new(address.ip(), Transport::Plain, None, Vec::new()).unwrap();
    let robot = Robot::connect(&run.socket());
    tokio::spawn(server::serve(listener, robot, access));
    format!("http://{address}/")
}

fn text(id: &str) -> String {
    format!("document.getElementById('{id}').textContent")
}

fn is_shown(id: &str) -> String {
    format!("document.getElementById('{id}').checkVisibility()")
}

/// Gives the page a gamepad whose left stick is pushed to the left, with or without a shoulder button held. `true` when done.
fn gamepad(is_held: bool) -> String {
    format!(
        "(() => {{ const buttons = Array(17).fill({{ pressed: false }}); buttons[4] = {{ pressed: {is_held} }};
            navigator.getGamepads = () => [null, {{ buttons, axes: [-1, 0.05, 0, 0] }}]; return true; }})()"
    )
}

/// Whether some pixels of the map are white, which free cells are.
const MAP_IS_SHOWN: &str = "(() => { const map = document.getElementById('map');
    const data = map.getContext('2d').getImageData(0, 0, map.width, map.height).data;
    let white = 0;
    for (let at = 0; at < data.length; at += 4) if (data[at] + data[at + 1] + data[at + 2] === 765) white++;
    return white > 2000; })()";

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs chromium; `cargo xtask test` runs it where that is installed"]
async fn the_page_shows_a_run_and_its_buttons_act() {
    let mut run = Explore::start(&["--seed", "1", "--no-recording"]);
    let page = serve(&run).await;
    let mut browser = Browser::start().await;
    browser.resize(1280, 800, 1.0).await;
    browser.open(&page).await;
    browser.wait("live data", "document.getElementById('link')?.textContent === 'live'").await;
    browser.wait("the map", MAP_IS_SHOWN).await;
    for image in ["camera", "depth"] {
        browser
            .wait(image, &format!("document.getElementById('{image}').naturalWidth > 100"))
            .await;
    }
    browser.wait("the health", &format!("{}.includes('Mapped floor')", text("health"))).await;

    browser.click("[data-order=pause]").await;
    browser.wait("a pause", &format!("{}.startsWith('Paused')", text("why"))).await;
    browser.click("[data-order=resume]").await;
    browser.wait("driving", &format!("!{}.startsWith('Paused')", text("why"))).await;
    browser.click("#stop").await;
    browser.wait("a stop", &format!("{}.includes('emergency stop')", text("why"))).await;
    let answer = browser.value(&text("answer")).await;
    assert_eq!(answer, "stop: the safety plane has stopped the robot");
    // No key arms it: the answer to the second key comes after what the first one did.
    browser.press_key("a").await;
    browser.press_key("p").await;
    browser.wait("a pause", &format!("{}.startsWith('pause: ')", text("answer"))).await;
    let why = browser.value(&text("why")).await;
    assert!(why.as_str().unwrap().contains("emergency stop"), "{why}");
    browser.click("[data-order=resume]").await;
    browser.click("[data-order=arm]").await;
    browser.wait("driving again", &format!("!{}.includes('Stopped')", text("why"))).await;
    browser.press_key("Escape").await;
    browser.wait("a stop by key", &format!("{}.includes('emergency stop')", text("why"))).await;

    // A tap on the map asks before the robot goes.
    browser.click("[data-order=arm]").await;
    browser.click("#map").await;
    browser.wait("the question", &is_shown("ask")).await;
    browser.click("#ask-go").await;
    browser
        .wait("the answer", &format!("{}.startsWith('go to: the robot takes it')", text("answer")))
        .await;
    run.end();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs chromium; `cargo xtask test` runs it where that is installed"]
async fn a_person_drives_by_hand_with_a_key_and_a_gamepad_chooses_a_policy_and_draws_an_area() {
    let mut run = Explore::start(&["--seed", "1", "--no-recording"]);
    let page = serve(&run).await;
    let mut browser = Browser::start().await;
    browser.resize(1280, 1100, 1.0).await;
    browser.open(&page).await;
    browser.wait("live data", "document.getElementById('link')?.textContent === 'live'").await;

    // The key drives only in this mode, and only while it is held.
    browser.click("#hand").await;
    browser.wait("the pad", &is_shown("pad")).await;
    browser.key("keyDown", "a").await;
    browser.wait("driving", &format!("{}.startsWith('Driven by hand')", text("why"))).await;
    browser.wait("a held pad", "document.getElementById('pad').classList.contains('held')").await;
    browser.key("keyUp", "a").await;
    browser
        .wait("standing", &format!("{}.startsWith('Stands where it was driven')", text("why")))
        .await;
    // A stick counts while a shoulder button is held, too.
    browser.wait("a gamepad", &gamepad(false)).await;
    let held = "document.getElementById('pad').classList.contains('held')";
    browser.wait("a pad that is not held", &format!("!{held}")).await;
    browser.wait("a held button", &gamepad(true)).await;
    browser.wait("driving", &format!("{}.startsWith('Driven by hand')", text("why"))).await;
    browser.wait("a held pad", held).await;
    browser.wait("a released button", &gamepad(false)).await;
    browser
        .wait("standing", &format!("{}.startsWith('Stands where it was driven')", text("why")))
        .await;
    browser.click("#hand").await;
    browser.press_key("p").await;
    browser.wait("a pause", &format!("{}.startsWith('Paused')", text("why"))).await;

    browser.choose("#policy", "frontier").await;
    browser.wait("the answer", &format!("{}.startsWith('explore by: ')", text("answer"))).await;
    browser.wait("exploring", &format!("!{}.startsWith('Paused')", text("why"))).await;

    browser.click("#draw").await;
    browser.wait("the question", &is_shown("fence")).await;
    let corners = [[100, 300], [200, 300], [200, 400], [100, 400]];
    for [x, y] in corners {
        browser.click_at(x, y).await;
    }
    browser.wait("four corners", &format!("{}.includes('four corners')", text("fence"))).await;
    browser.click("#fence [type=submit]").await;
    browser.wait("the answer", &format!("{}.startsWith('keep out: ')", text("answer"))).await;
    browser.wait("the area", "!document.getElementById('open-areas').hidden").await;
    browser.click("#draw").await;
    browser.click("#open-areas").await;
    browser.wait("no area", "document.getElementById('open-areas').hidden").await;
    run.end();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs chromium; `cargo xtask test` runs it where that is installed"]
async fn a_robot_that_is_gone_is_shown_as_lost_and_as_live_when_it_is_back() {
    let mut run = Explore::start(&["--seed", "1", "--no-recording"]);
    let page = serve(&run).await;
    let mut browser = Browser::start().await;
    browser.open(&page).await;
    browser.wait("live data", "document.getElementById('link')?.textContent === 'live'").await;
    // The page itself measures how long it takes from the last data to the alarm.
    let watch = "window.seen = new Promise((done) => {
        let last = performance.now();
        new MutationObserver(() => { last = performance.now(); })
            .observe(document.getElementById('facts'), {childList: true, characterData: true, subtree: true});
        const lost = document.getElementById('lost');
        new MutationObserver(() => { if (!lost.hidden) done(performance.now() - last); })
            .observe(lost, {attributes: true});
    }); true";
    browser.value(watch).await;
    tokio::time::sleep(Duration::from_millis(500)).await;
    run.kill();
    let after_ms = browser.value("window.seen").await.as_f64().unwrap();
    println!("the lost link is shown {after_ms:.0} ms after the last data");
    // Its limit is 0.8 s; the rest is for a computer that does something else as well.
    assert!(after_ms < 3000.0, "{after_ms} ms");
    assert_eq!(browser.value(&is_shown("lost")).await, true);
    let said = browser.value(&text("lost")).await;
    assert!(said.as_str().unwrap().contains("STOP does not reach it"), "{said}");

    // Another run at the same socket.
    let again = Explore::start(&["--seed", "2", "--no-recording"]);
    let _ = std::fs::remove_file(run.socket());
    std::os::unix::fs::symlink(again.socket(), run.socket()).unwrap();
    browser
        .wait("live data again", "document.getElementById('link')?.textContent === 'live'")
        .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs chromium; `cargo xtask test` runs it where that is installed"]
async fn a_robot_that_is_silent_and_a_view_that_is_gone_are_shown_as_lost() {
    let run = Arc::new(Explore::start(&["--seed", "1", "--no-recording"]));
    // The view has threads of its own, which can end while the browser goes on.
    let view = tokio::runtime::Runtime::new().unwrap();
    let of_the_view = Arc::clone(&run);
    let page = view.spawn(async move { serve(&of_the_view).await }).await.unwrap();
    let mut browser = Browser::start().await;
    browser.open(&page).await;
    let is_live = "document.getElementById('link')?.textContent === 'live'";
    browser.wait("live data", is_live).await;

    run.signal(Signal::STOP);
    browser.wait("silence", &is_shown("lost")).await;
    run.signal(Signal::CONT);
    browser.wait("live data again", is_live).await;

    view.shutdown_background();
    let said = format!("{}.startsWith('The link to live-view is lost')", text("lost"));
    browser.wait("a lost view", &said).await;
}

/// Makes the images of docs/live-view.md: `cargo xtask live` runs it.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "writes docs/images; `cargo xtask live` runs it"]
async fn screenshots_for_the_documentation() {
    let images = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/images");
    let run = Explore::with("[camera]\nwidth = 480\nheight = 144\n", &["--seed", "1"]);
    let page = serve(&run).await;
    let mut laptop = Browser::start().await;
    let mut phone = Browser::start().await;
    laptop.resize(1366, 860, 1.0).await;
    phone.resize(360, 780, 2.0).await;
    laptop.open(&page).await;
    phone.open(&page).await;
    let seconds = std::env::var("LIVE_SECONDS").ok().and_then(|text| text.parse().ok());
    tokio::time::sleep(Duration::from_secs(seconds.unwrap_or(90))).await;
    laptop.wait("driving", &format!("{}.startsWith('Drives to')", text("why"))).await;
    laptop.screenshot(&images.join("live-laptop.png")).await;
    phone.screenshot(&images.join("live-phone.png")).await;
}
