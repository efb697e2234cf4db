//! Models are swapped while the robot drives.

use std::path::{Path, PathBuf};

use drivers::can::Protocol;
use firmware_host::model::{State, Store, What};

use super::scene::Scene;

/// The robot's models, as another process sees them.
struct Models {
    store: Store,
    /// The key that signs them.
    key: PathBuf,
    /// Ticks that were left out while nothing happened but this swap.
    left_out: Vec<u64>,
}

impl Models {
    /// Makes a change in the store, and waits until `digest` drives.
    fn swap(&mut self, scene: &Scene, digest: &str, change: impl FnOnce(&mut Store)) {
        let before = scene.skipped();
        change(&mut self.store);
        scene.wait("another model", |scene| drives(scene).as_deref() == Some(digest));
        self.left_out.push(scene.skipped() - before);
    }

    fn sign(&self, model: &[u8], name: &str) -> String {
        let key = signed_model::read_secret_key(&self.key, || panic!("no password")).unwrap();
        signed_model::sign(model, name, &key).unwrap()
    }

    fn install(&mut self, scene: &Scene, name: &str) -> String {
        let model = std::fs::read(model(name)).unwrap();
        let digest = blake3::hash(&model).to_hex().to_string();
        let signature = self.sign(&model, name);
        self.swap(scene, &digest, |store| store.install(&model, &signature, name).unwrap());
        digest
    }

    fn state(&self) -> State {
        self.store.state().unwrap()
    }

    /// What became of the newest model.
    fn last(&self) -> What {
        self.store.history().entries.last().unwrap().what
    }
}

fn model(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/models/{name}.onnx"))
}

fn drives(scene: &Scene) -> Option<String> {
    scene.status()?.exploration.model
}

#[test]
fn models_are_swapped_while_it_drives_kept_or_taken_back_and_no_tick_is_left_out_for_it() {
    let more = "\n[models]\nstore = \"{}/models\"\ntrusted_keys = \"{}/trusted_keys\"\ntrial_ticks = 20\ntrial_m = 0.1\n";
    let guess = model("guess");
    let mut scene = Scene::with(Protocol::Odrive, more, &["--model", guess.to_str().unwrap()]);
    scene.drives_first();
    // The network that came with the program is the store's first.
    let mut models = Models {
        store: Store::open(&scene.path("models")).unwrap(),
        key: scene.path("key"),
        left_out: Vec::new(),
    };
    let line = signed_model::generate_keys(&models.key, None, "workshop").unwrap();
    std::fs::write(scene.path("trusted_keys"), line).unwrap();
    let first = models.state().current().unwrap().to_owned();
    assert_eq!(first, blake3::hash(&std::fs::read(guess).unwrap()).to_hex().to_string());
    assert_eq!(drives(&scene).as_ref(), Some(&first));

    let better = models.install(&scene, "better");
    scene.wait("the trial's end", |_| models.last() == What::Kept);
    assert_eq!(
        models.state(),
        State { models: vec![better.clone(), first.clone()], trial_starts: None }
    );
    // An operator goes back and forth.
    for _ in 0..3 {
        models.swap(&scene, &first, |store| drop(store.roll_back("an operator").unwrap()));
        models.install(&scene, "better");
    }
    scene.wait("the trial's end", |_| models.last() == What::Kept);
    // One that misbehaves is taken back by the robot itself.
    let bad = std::fs::read(model("nan_in_the_dark")).unwrap();
    let signature = models.sign(&bad, "nan_in_the_dark");
    models.store.install(&bad, &signature, "nan_in_the_dark").unwrap();
    scene.wait("a rollback", |_| models.last() == What::RolledBack);
    let why = models.store.history().entries.last().unwrap().why.clone();
    assert!(why.contains("NaN"), "{why}");
    assert_eq!(models.state().current(), Some(&*better));
    scene.wait("the model before it", |scene| drives(scene).as_ref() == Some(&better));
    scene.drives("driving on");

    // Other programs may delay a tick on this computer. A swap that waits for the disk or for the network to load would
    // cost ticks every time.
    let without = models.left_out.iter().filter(|ticks| **ticks == 0).count();
    assert!(
        2 * without > models.left_out.len(),
        "ticks left out at each swap: {:?}",
        models.left_out
    );
    println!("ticks left out at each swap: {:?}", models.left_out);
    let store = scene.path("models");
    scene.ends_and_replays(&[Path::new("--model-store"), &store]);
}
