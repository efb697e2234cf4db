//! `firmware-host perceive`: estimates depth on recorded images, measures its accuracy and draws a
//! map.

mod restarts;
mod source;

use std::time::Instant;

use anyhow::{Result, bail};
use hal::ImageView;
use runtime::accuracy::{Accuracy, ConstantBaseline};
use runtime::event::Event;
use runtime::perception::{DepthEstimate, DepthNetwork, GivenDepth};

use crate::cli::PerceiveArgs;
use crate::dataset::Dataset;
use crate::dump::{Depths, Dump, Shot};
use crate::frame_depth::{self, FrameDepth};
use crate::report::another_run::refuse_run;
use crate::report::atomic::prepare_dir;
use crate::report::depth_sample::{FrameDepths, SheetRow, SheetSampler};
use crate::report::depth_scale::DepthScale;
use crate::report::depth_sheet::DepthSheet;
use crate::report::events::EventCounts;
use crate::report::latency::Stage;
use crate::report::progress::{Progress, Status};
use crate::report::summary::{DepthAccuracy, Summary, peak_resident_mib};
use crate::report::table;
use crate::report::top_view::TopView;
use crate::setup;
use crate::stopwatch::Stopwatch;
use restarts::Restarts;
use source::{Source, View};

/// Processes every image of the sequence and writes the reports.
///
/// # Errors
/// If the dataset or recording or the model cannot be read, or the output folder cannot be written.
pub fn run(args: &PerceiveArgs) -> Result<()> {
    let source = Source::open(args)?;
    let config = source.config();
    let camera = *source.camera();
    let network =
        args.model.as_deref().map(|path| setup::load_network(path, &camera, config)).transpose()?;
    refuse_run(&args.out)?;
    prepare_dir(&args.out)?;
    let mut dump = args.dump.as_deref().map(|dir| Dump::create(dir, &camera)).transpose()?;

    // A recorded robot stood on a floor; how the camera of another sequence was held is not known.
    let mount = source.is_recording().then(|| config.camera.t_base_camera());
    let mut evaluator = Evaluator {
        depth: FrameDepth::new(&config.coarse, &config.dense, camera, mount.as_ref())?,
        restarts: args.restart_every.map(|every| Restarts::new(every, config, camera, mount)),
        network,
        joined: DepthEstimate::none(camera.width, camera.height),
        coarse_accuracy: Accuracy::new(),
        dense_accuracy: Accuracy::new(),
        network_accuracy: Accuracy::new(),
        refined_accuracy: Accuracy::new(),
        constant: ConstantBaseline::new(),
        events: EventCounts::default(),
        stopwatch: Stopwatch::default(),
        sheet: SheetSampler::default(),
        map: source.dataset().map(top_view).transpose()?,
        path_m: 0.0,
    };
    let began = Instant::now();
    let mut progress = source.len().map(Progress::start);
    let mut last: Option<hal::Pose3> = None;
    let mut frames = 0;
    for view in source.views() {
        let view = view?;
        let sample = &view.sample;
        if let Some(last) = last {
            evaluator.path_m +=
                (sample.t_world_camera.translation.vector - last.translation.vector).norm();
        }
        last = Some(sample.t_world_camera);
        let depths = evaluator.process(frames, &view)?;
        if let Some(dump) = &mut dump {
            // A recording already contains its images and ground truth.
            let stored = (!source.is_recording()).then_some(sample);
            let shot = Shot {
                time_ns: sample.time_ns,
                t_world_camera: sample.t_world_camera,
                rgb: stored.map(|sample| &sample.rgb[..]),
                truth: stored.and_then(|sample| sample.truth.as_ref()),
                view: None,
            };
            dump.add(&shot, &depths)?;
        }
        frames += 1;
        if let Some(progress) = &mut progress {
            progress.frame(frames, &Status { coverage: None, doing: "estimating depth" });
        }
    }
    if let Some(progress) = progress {
        progress.finish();
    }
    if frames == 0 {
        let path = source.path().display();
        bail!("{path} has no frame that can be read; see firmware-host buffer verify {path}");
    }
    if let Some(dump) = dump {
        dump.write_index()?;
    }

    let wall_s = began.elapsed().as_secs_f64();
    let name = source.path().display().to_string();
    let summary = evaluator.summary(frames, wall_s, &name);
    summary.write(&args.out)?;
    println!("{}", table::render(&summary));
    let title = format!("{name}, {frames} frames");
    if let (Some(map), Some(dataset)) = (&evaluator.map, source.dataset()) {
        map.write(&format!("{}, {frames} frames, from above", dataset.manifest().name), &args.out)?;
    }
    let rows = evaluator.sheet.into_rows();
    DepthSheet { title: &title, rows: &rows, scale: DepthScale::of(rows.iter()) }
        .write(&args.out)?;
    if source.without_pose() > 0 {
        println!(
            "{} images were left out because the dataset has no pose near them in time.",
            source.without_pose()
        );
    }
    let out = args.out.display();
    let map = if source.is_recording() { String::new() } else { format!("{out}/map.png, ") };
    println!("Wrote {map}{out}/depth.png and {out}/summary.json.");
    Ok(())
}

fn top_view(dataset: &Dataset) -> Result<TopView> {
    Ok(TopView::new(&dataset.poses(), dataset.manifest().up.map(Into::into))?)
}

/// Runs coarse depth and the network, and collects their accuracy and timing.
struct Evaluator {
    depth: FrameDepth,
    /// What a robot knows that has just started, for the dump.
    restarts: Option<Restarts>,
    network: Option<DepthNetwork>,
    /// The network's depth, joined with dense depth if it was given that.
    joined: DepthEstimate,
    coarse_accuracy: Accuracy,
    dense_accuracy: Accuracy,
    network_accuracy: Accuracy,
    /// Accuracy of the network on the pixels that have coarse depth.
    refined_accuracy: Accuracy,
    constant: ConstantBaseline,
    events: EventCounts,
    stopwatch: Stopwatch,
    sheet: SheetSampler,
    /// `None` for a recorded run, which already has a map.
    map: Option<TopView>,
    path_m: f64,
}

impl Evaluator {
    /// Processes one image. Returns its depth without a network, as it is dumped.
    fn process(&mut self, index: u64, view: &View) -> Result<Depths<'_>> {
        let View { sample, scan, moment } = view;
        let frame = ImageView::rgb8(sample.camera.width, sample.camera.height, &sample.rgb)?;
        let shot = frame_depth::Shot {
            frame,
            t_odom_camera: sample.t_world_camera,
            scan: scan.as_ref().map(|(scan, t_odom_laser)| (scan, *t_odom_laser)),
            moment: *moment,
        };
        let began = Instant::now();
        self.stopwatch.start();
        if let Err(why) = self.depth.estimate(&shot) {
            self.events.add(&Event::NoDepth { why });
        }
        self.stopwatch.lap(Stage::Coarse);
        self.depth.complete(&shot);
        self.stopwatch.lap(Stage::Dense);
        let coarse = self.depth.coarse();
        let dense = self.depth.dense();
        let mut refined = None;
        if let Some(network) = &mut self.network {
            let given = self.depth.given(network.spec().given);
            match network.estimate(frame, &sample.t_world_camera, given) {
                Ok(_) => {
                    self.joined.copy_from(network.last());
                    if let Some(dense) = dense.filter(|_| network.spec().given == GivenDepth::Dense)
                    {
                        // As on the robot.
                        self.joined.join(dense);
                    }
                    refined = Some(&self.joined);
                }
                Err(why) => self.events.add(&Event::NoDepth { why }),
            }
            self.stopwatch.lap(Stage::Network);
        }
        self.stopwatch.since(began, Stage::Total);
        if let Some(map) = &mut self.map {
            map.add(&sample.t_world_camera, refined.or(coarse), &sample.camera)?;
        }
        if let Some(truth) = &sample.truth {
            self.coarse_accuracy.add(coarse, truth)?;
            self.dense_accuracy.add(dense, truth)?;
            self.constant.add(truth);
            if let Some(refined) = refined {
                self.network_accuracy.add(Some(refined), truth)?;
                match coarse {
                    Some(coarse) => {
                        self.refined_accuracy.add_where(refined, &coarse.depth, truth)?;
                    }
                    None => self.refined_accuracy.add(None, truth)?,
                }
            }
        }
        let depths = FrameDepths { coarse, dense, network: refined, truth: sample.truth.as_ref() };
        self.sheet.offer(index, depths.count(), || SheetRow::capture(index, &frame, &depths));
        let restarted = match &mut self.restarts {
            Some(restarts) => restarts.dense(index, &shot)?,
            None => None,
        };
        Ok(Depths { coarse, dense: restarted.unwrap_or(dense) })
    }

    fn summary(&self, frames: u64, wall_s: f64, dataset: &str) -> Summary {
        let constant = self.constant.rows();
        let network = self.network_accuracy.rows();
        let dense = self.dense_accuracy.rows();
        let accuracy = constant.all.is_some().then(|| DepthAccuracy {
            coarse: Some(self.coarse_accuracy.rows()),
            dense: dense.all.is_some().then_some(dense),
            network: network.all.is_some().then_some(network),
            refined: self.refined_accuracy.rows().all,
            constant: Some(constant),
        });
        Summary {
            frames,
            dataset: Some(dataset.to_owned()),
            model: self.network.as_ref().map(|network| network.digest().to_owned()),
            path_m: Some(self.path_m),
            events: self.events.clone(),
            wall_s: Some(wall_s),
            frames_per_s: Some(frames as f64 / wall_s),
            latency_ms: self.stopwatch.latencies().percentiles(),
            accuracy,
            resident_mib: peak_resident_mib(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            ..Summary::default()
        }
    }
}
