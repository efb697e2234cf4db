//! Starts a virtual machine, runs scenarios in it, and reads their output.

use std::fmt::Write as _;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};

use super::scenario::{Kernel, Scenario};
use super::setup;
use super::table::Row;
use crate::{command, paths};

/// Two cameras with a webcam and an HDMI input and an HDMI output each; the second one is multi-planar.
const VIVID: &str = "n_devs=2 node_types=0x101,0x101 num_inputs=2,2 input_types=0xc,0xc num_outputs=1,1 \
                     output_types=1,1 multiplanar=1,2";
/// Time for booting, loading the modules and switching off.
const BOOT_SECONDS: u64 = 60;

/// Scenarios that one machine can run.
#[derive(Debug)]
pub struct Machine<'a> {
    kernel: Kernel,
    icount: Option<u8>,
    disk_mb: Option<u64>,
    systemd: bool,
    modules: Vec<&'a str>,
    scenarios: Vec<&'a Scenario>,
}

impl<'a> Machine<'a> {
    /// Whether this machine can run the scenario too.
    fn fits(&self, scenario: &Scenario) -> bool {
        self.kernel == scenario.kernel
            && self.icount == scenario.icount
            && self.systemd == scenario.systemd
            && self.disk_mb.is_none()
            && scenario.disk_mb.is_none()
    }

    /// Groups scenarios into as few machines as possible. A scenario that needs a disk gets a machine of its own, because it may
    /// corrupt the disk.
    pub fn for_scenarios(scenarios: &'a [Scenario]) -> Vec<Self> {
        let mut machines: Vec<Self> = Vec::new();
        for scenario in scenarios {
            let fitting = machines.iter().position(|machine| machine.fits(scenario));
            let index = fitting.unwrap_or_else(|| {
                let Scenario { kernel, icount, disk_mb, systemd, .. } = *scenario;
                machines.push(Self {
                    kernel,
                    icount,
                    disk_mb,
                    systemd,
                    modules: Vec::new(),
                    scenarios: Vec::new(),
                });
                machines.len() - 1
            });
            let machine = &mut machines[index];
            machine.scenarios.push(scenario);
            for module in scenario.modules.iter().map(String::as_str) {
                if !machine.modules.contains(&module) {
                    machine.modules.push(module);
                }
            }
        }
        machines
    }

    fn name(&self) -> String {
        let names: Vec<_> = self.scenarios.iter().map(|scenario| scenario.name.as_str()).collect();
        format!(
            "{}{}: {}",
            self.kernel.name(),
            self.icount.map_or(String::new(), |_| " (virtual time)".to_owned()),
            names.join(", ")
        )
    }
}

/// Boots a machine and runs all of its scenarios. Returns their checks.
///
/// # Errors
/// When the machine cannot be started. A machine that ends early is a failed check.
pub fn run(machine: &Machine<'_>, programs: &[(&str, String)]) -> Result<Vec<Row>> {
    println!("\nbooting {}", machine.name());
    let folder = prepare(machine, programs)?;
    let mut report = Report::new(folder.join("output.log"))?;
    let mut end = boot(machine, &folder, &mut report)?;
    // There is at most one power cut: the second boot checks what is left on the disk.
    if matches!(end, End::PowerCut) {
        println!("  power cut; booting again");
        std::fs::write(folder.join("after_power_cut"), "")?;
        end = boot(machine, &folder, &mut report)?;
    }
    let why = match end {
        End::Off => "the guest switched off before its end",
        End::OutOfTime => "the guest ran out of time",
        End::PowerCut => "a second power cut",
    };
    for scenario in &machine.scenarios {
        if !report.ended.contains(&scenario.name) {
            report.fail(
                &scenario.name,
                &format!("{why}: {}", last_line(&folder.join("console.log"))),
            );
        }
    }
    if report.rows.iter().all(|row| row.passed) {
        std::fs::remove_dir_all(&folder)?;
    }
    Ok(report.rows)
}

/// How a machine ended.
enum End {
    Off,
    OutOfTime,
    PowerCut,
}

fn boot(machine: &Machine<'_>, folder: &Path, report: &mut Report) -> Result<End> {
    let mut child = qemu(machine, folder)?;
    // Closing its standard input would close the guest's port.
    let input = child.stdin.take();
    let allowed =
        BOOT_SECONDS + machine.scenarios.iter().map(|scenario| scenario.seconds).sum::<u64>();
    let clock = Clock::of(machine, &child);
    let end = read(&mut child, report, &clock, Duration::from_secs(allowed));
    // SIGKILL: everything that the guest has not written to its disk is lost.
    _ = child.kill();
    child.wait()?;
    drop(input);
    end
}

/// The folder that is /rig in the guest.
fn prepare(machine: &Machine<'_>, programs: &[(&str, String)]) -> Result<PathBuf> {
    let icount = machine.icount.map_or(String::new(), |shift| format!("-i{shift}"));
    let first = machine.scenarios.first().map_or("", |scenario| &scenario.name);
    let folder =
        paths::target().join("rig/run").join(format!("{}{icount}-{first}", machine.kernel.name()));
    if folder.exists() {
        std::fs::remove_dir_all(&folder)?;
    }
    std::fs::create_dir_all(&folder)?;
    if let Some(megabytes) = machine.disk_mb {
        std::fs::File::create(folder.join("disk"))?.set_len(megabytes << 20)?;
    }
    let modules = setup::folder(machine.kernel).join("lib/modules");
    let environment = format!(
        "MODULES='{}' VIVID='{VIVID}' KERNEL_MODULES='{}' SYSTEMD='{}'\n",
        machine.modules.join(" "),
        modules.display(),
        if machine.systemd { "yes" } else { "" }
    );
    std::fs::write(folder.join("environment"), environment)?;
    std::fs::copy(paths::root().join("tests/rig/guest.sh"), folder.join("guest.sh"))?;
    let mut commands = "cd /tmp\n".to_owned();
    for (variable, path) in programs {
        writeln!(commands, "export {variable}='{path}'")?;
    }
    for scenario in &machine.scenarios {
        let name = &scenario.name;
        let seconds = scenario.seconds;
        std::fs::write(
            folder.join(format!("{name}.sh")),
            format!(". /rig/guest.sh\n{}", scenario.body),
        )?;
        writeln!(
            commands,
            "printf 'BEGIN\\t{name}\\n'; timeout -k 5 {seconds} bash /rig/{name}.sh"
        )?;
        writeln!(commands, "printf 'END\\t{name}\\t%s\\n' $?")?;
    }
    std::fs::write(folder.join("commands"), commands)?;
    Ok(folder)
}

fn qemu(machine: &Machine<'_>, folder: &Path) -> Result<Child> {
    let kernel = setup::folder(machine.kernel);
    let folder = folder.display();
    let mut line = format!(
        "-M pc -cpu max -m 2048 -no-reboot -display none -nodefaults -nic none \
         -kernel {kernel}/vmlinux -initrd {kernel}/initrd.img -serial file:{folder}/console.log \
         -qmp unix:{folder}/qmp,server=on,wait=off -pidfile {folder}/pid \
         -fsdev local,id=root,path=/,security_model=none,readonly=on,multidevs=remap \
         -device virtio-9p-pci,fsdev=root,mount_tag=root \
         -fsdev local,id=rig,path={folder},security_model=none -device virtio-9p-pci,fsdev=rig,mount_tag=rig \
         -device virtio-serial-pci -chardev stdio,id=out,signal=off -device virtserialport,chardev=out,name=rig.out \
         -object can-bus,id=bus0 -device kvaser_pci,canbus=bus0 -device kvaser_pci,canbus=bus0 \
         -chardev socket,id=lidar,path={folder}/lidar,server=on,wait=off -chardev socket,id=lidarsim,path={folder}/lidar \
         -device piix3-usb-uhci,id=usb -device usb-serial,id=lidar,bus=usb.0,chardev=lidar \
         -device pci-serial,chardev=lidarsim",
        kernel = kernel.display(),
    );
    match machine.icount {
        // Virtual time uses one processor, because booting hangs with two.
        Some(shift) => {
            write!(line, " -smp 1 -accel tcg,thread=single -icount shift={shift},sleep=off")?;
        }
        None => line.push_str(" -smp 2 -accel tcg,thread=multi"),
    }
    if machine.disk_mb.is_some() {
        write!(line, " -drive file={folder}/disk,if=virtio,format=raw,cache=writeback")?;
    }
    let mut qemu: Command = command::program("qemu-system-x86_64");
    qemu.args(line.split_whitespace()).args([
        "-append",
        // `no_timer_check`: on a busy host the emulated timer is late, and its check ends in a panic.
        "console=ttyS0 quiet loglevel=4 edd=off panic=-1 mitigations=off nokaslr random.trust_cpu=on no_timer_check",
    ]);
    qemu.stdin(Stdio::piped()).stdout(Stdio::piped());
    qemu.spawn().context("cannot start qemu-system-x86_64")
}

/// How the time of a machine is limited.
struct Clock {
    start: Instant,
    /// The process by whose processor time the machine is limited, in virtual time.
    process: Option<u32>,
}

impl Clock {
    fn of(machine: &Machine<'_>, child: &Child) -> Self {
        Self { start: Instant::now(), process: machine.icount.map(|_| child.id()) }
    }

    /// In virtual time the guest ends a scenario that takes too long. How long that takes depends on the load of the host, so a
    /// hanging machine is detected by its processor time, and by wall time in case it hangs without work.
    fn elapsed(&self) -> Duration {
        let wall = self.start.elapsed();
        self.process.and_then(processor_time).map_or(wall, |worked| worked.max(wall / 20))
    }
}

/// Processor time of a process: the 14th and 15th field of proc(5)'s stat, in hundredths of a second.
fn processor_time(process: u32) -> Option<Duration> {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    // The third field follows the program's name, which may contain any character.
    let fields: Vec<_> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    let hundredths = fields.get(11)?.parse::<u64>().ok()? + fields.get(12)?.parse::<u64>().ok()?;
    Some(Duration::from_millis(10 * hundredths))
}

/// Reads until the machine is off, has reached its limit, or requests a power cut.
fn read(child: &mut Child, report: &mut Report, clock: &Clock, allowed: Duration) -> Result<End> {
    let output = child.stdout.take().context("qemu without output")?;
    let (lines, received) = sync_channel(100);
    std::thread::spawn(move || {
        for line in BufReader::new(output).lines().map_while(Result::ok) {
            if lines.send(line).is_err() {
                return;
            }
        }
    });
    loop {
        match received.recv_timeout(Duration::from_secs(1)) {
            Ok(line) if line.trim_end() == "POWER CUT" => return Ok(End::PowerCut),
            Ok(line) => report.line(&line)?,
            Err(RecvTimeoutError::Disconnected) => return Ok(End::Off),
            Err(RecvTimeoutError::Timeout) => {}
        }
        if clock.elapsed() > allowed {
            return Ok(End::OutOfTime);
        }
    }
}

/// The guest's output so far.
struct Report {
    log: std::fs::File,
    rows: Vec<Row>,
    ended: Vec<String>,
    scenario: String,
    checks: usize,
    since: Instant,
}

impl Report {
    fn new(log: PathBuf) -> Result<Self> {
        let log = std::fs::File::create(log)?;
        Ok(Self {
            log,
            rows: Vec::new(),
            ended: Vec::new(),
            scenario: String::new(),
            checks: 0,
            since: Instant::now(),
        })
    }

    fn line(&mut self, line: &str) -> Result<()> {
        // Keeps the tab at the end of a check without a figure.
        let line = line.trim_end_matches('\r');
        std::io::Write::write_all(&mut self.log, format!("{line}\n").as_bytes())?;
        let words: Vec<_> = line.split('\t').collect();
        match words.as_slice() {
            ["BEGIN", name] => {
                (*name).clone_into(&mut self.scenario);
                self.checks = 0;
                println!("  {name}, after {:.1} s", self.since.elapsed().as_secs_f64());
                self.since = Instant::now();
            }
            ["CHECK", outcome, promise, figure @ ..] => {
                self.checks += 1;
                self.row(promise, &figure.join(" "), *outcome == "pass");
            }
            ["END", name, status] => {
                self.ended.push((*name).to_owned());
                if *status != "0" {
                    self.fail(name, &format!("ended with {status}; its output is in output.log"));
                } else if self.checks == 0 {
                    self.fail(name, "checked nothing");
                }
            }
            _ => println!("    {line}"),
        }
        Ok(())
    }

    fn row(&mut self, promise: &str, figure: &str, passed: bool) {
        let seconds = self.since.elapsed().as_secs_f64();
        self.since = Instant::now();
        println!("  {}  {promise}: {figure}", if passed { "pass" } else { "FAIL" });
        let (scenario, promise, figure) =
            (self.scenario.clone(), promise.to_owned(), figure.to_owned());
        self.rows.push(Row { scenario, promise, figure, passed, seconds });
    }

    fn fail(&mut self, scenario: &str, why: &str) {
        scenario.clone_into(&mut self.scenario);
        self.row("runs to its end", why, false);
    }
}

fn last_line(console: &Path) -> String {
    let text = std::fs::read(console).unwrap_or_default();
    String::from_utf8_lossy(&text)
        .lines()
        .rev()
        .find(|line| !line.trim().is_empty())
        .unwrap_or("no console")
        .to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_check_that_fails_has_failed_whatever_it_says() {
        let log = std::env::temp_dir().join(format!("rig-report-{}", std::process::id()));
        let mut report = Report::new(log.clone()).unwrap();
        for line in [
            "BEGIN\tservice",
            "CHECK\tfail\tit starts\t\r",
            "CHECK\tfail\tit ends\t1\t2",
            "END\tservice\t0",
        ] {
            report.line(line).unwrap();
        }
        std::fs::remove_file(log).unwrap();
        let [starts, ends] = &report.rows[..] else { panic!("{:?}", report.rows) };
        assert!(!starts.passed && starts.promise == "it starts" && starts.figure.is_empty());
        assert!(!ends.passed && ends.figure == "1 2");
    }

    #[test]
    fn a_process_is_asked_how_long_it_has_worked() {
        let start = Instant::now();
        let before = worked();
        while worked() < before + Duration::from_millis(20) {
            assert!(start.elapsed() < Duration::from_secs(60), "{:?}", worked());
        }
        assert_eq!(processor_time(u32::MAX), None);
    }

    fn worked() -> Duration {
        processor_time(std::process::id()).unwrap()
    }
}
