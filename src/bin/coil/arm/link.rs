//! A link with its port and clock: native ports, or the simulated board in simulated time.

use anyhow::{Context, bail};
use coil_ps::arm::Transport;
use coil_ps::arm::fault::{Fault, Faulty};
use coil_ps::arm::grbl::{Command, Event, Failure, Link, Phase};
use coil_ps::arm::simulated::{Simulated, Truth};
use std::process::exit;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Which arm.
#[derive(clap::Args, Clone)]
pub struct PortArgs {
    /// Serial port of the arm (coil arm ports lists them), or sim for the simulated one.
    #[arg(long, default_value = "sim")]
    pub arm: String,
    /// Speed of the simulated arm's clock.
    #[arg(long, value_enum, default_value = "fast")]
    pub pace: Pace,
    /// A fault of the simulated arm and when, as garblesent@12.5 (seconds): to see what happens.
    #[arg(long, value_name = "FAULT@SECONDS", value_parser = fault)]
    pub fault: Option<(Fault, f64)>,
    /// Print every line that passes.
    #[arg(long)]
    pub trace: bool,
}

/// How fast simulated time runs.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Pace {
    /// As fast as this machine can.
    Fast,
    /// As real time does.
    Real,
}

fn fault(text: &str) -> Result<(Fault, f64), String> {
    let known = || Fault::ALL.map(|f| format!("{f:?}").to_lowercase()).join(", ");
    let (name, at) =
        text.split_once('@').ok_or_else(|| format!("write FAULT@SECONDS, as unplug@8: {}", known()))?;
    let fault = Fault::by_name(name).ok_or_else(|| format!("no fault '{name}': {}", known()))?;
    let at = at.parse::<f64>().ok().filter(|t| (0.0..1e6).contains(t)).ok_or("the time must be seconds")?;
    Ok((fault, at))
}

enum Port {
    Simulated(Box<Faulty>),
    #[cfg(feature = "serial")]
    Native(native::Native),
}

impl Port {
    fn transport(&mut self) -> &mut dyn Transport {
        match self {
            Self::Simulated(port) => port.as_mut(),
            #[cfg(feature = "serial")]
            Self::Native(port) => port,
        }
    }
}

/// Status of a program that was interrupted, as shells have it.
const INTERRUPTED: i32 = 130;

/// A link, its port and its clock. Ctrl-C and SIGTERM are Stop; the second time they end the program at once.
pub struct Driver {
    link: Link,
    port: Port,
    start: Instant,
    now: Duration,
    real_time: bool,
    events: Vec<Event>,
    /// Somebody wants the program to end.
    interrupted: Arc<AtomicBool>,
    /// Print every line that passes.
    pub show_log: bool,
}

const FOREVER: Duration = Duration::from_secs(3600 * 24);

impl Driver {
    /// Opens the port and waits until the firmware has told its settings.
    ///
    /// # Errors
    /// Why it can't be opened, or is no Grbl.
    pub fn connect(args: &PortArgs) -> anyhow::Result<Self> {
        let interrupted = Arc::new(AtomicBool::new(false));
        let flag = interrupted.clone();
        ctrlc::set_handler(move || {
            if flag.swap(true, Ordering::Relaxed) {
                exit(INTERRUPTED);
            }
        })
        .context("Ctrl-C could not be made a Stop")?;
        let (port, real_time) = if args.arm == "sim" {
            let (fault, at) = args.fault.unwrap_or((Fault::Split, f64::from(u32::MAX)));
            let port = Faulty::new(Simulated::arm(), fault, Duration::from_secs_f64(at), 1);
            (Port::Simulated(Box::new(port)), args.pace == Pace::Real)
        } else {
            if args.fault.is_some() {
                bail!("--fault is for the simulated arm (--arm sim)");
            }
            (native_port(&args.arm)?, true)
        };
        let mut driver = Self {
            link: Link::new(),
            port,
            start: Instant::now(),
            now: Duration::ZERO,
            real_time,
            events: Vec::new(),
            interrupted,
            show_log: args.trace,
        };
        driver.open()?;
        driver.wait_ready()?;
        Ok(driver)
    }

    fn open(&mut self) -> anyhow::Result<()> {
        let now = self.now();
        match &mut self.port {
            Port::Simulated(port) => port.open(now)?,
            #[cfg(feature = "serial")]
            Port::Native(port) => port.open()?,
        }
        self.link.opened(now);
        Ok(())
    }

    fn wait_ready(&mut self) -> anyhow::Result<()> {
        let end = self.now() + Duration::from_secs(40);
        loop {
            self.pump()?;
            match self.link.phase() {
                Phase::Ready => return Ok(()),
                Phase::Closed(why) => bail!("{}", why.clone().unwrap_or_default()),
                Phase::Stopped(_) => return Err(Failure::Stopped.into()),
                _ if self.now() > end => bail!("the board does not tell its settings"),
                _ => self.sleep(None),
            }
        }
    }

    /// The link.
    #[must_use]
    pub fn link(&self) -> &Link {
        &self.link
    }

    /// The link, to be driven by a capture.
    pub fn link_mut(&mut self) -> &mut Link {
        &mut self.link
    }

    /// The time: real, or simulated.
    #[must_use]
    pub fn now(&self) -> Duration {
        if self.real_time { self.start.elapsed() } else { self.now }
    }

    /// What is really so, of a simulated arm.
    pub fn truth(&mut self) -> Option<Truth> {
        let now = self.now();
        match &mut self.port {
            Port::Simulated(port) => {
                // Bytes stay in the port: only its clock is set.
                port.board.feed(now, &[]);
                Some(port.board.truth())
            }
            #[cfg(feature = "serial")]
            Port::Native(_) => None,
        }
    }

    /// Lets the time pass that something simulated takes.
    pub fn spend(&mut self, time: Duration) {
        if self.real_time {
            std::thread::sleep(time);
        }
        self.now += time;
    }

    /// Passes bytes both ways, once.
    ///
    /// # Errors
    /// None now: a lost port is a phase of the link.
    pub fn pump(&mut self) -> anyhow::Result<()> {
        if !self.real_time {
            self.now += Duration::from_micros(10);
        }
        let now = self.now();
        if self.interrupted.load(Ordering::Relaxed) && !matches!(self.link.phase(), Phase::Stopped(_)) {
            self.link.stop(now);
        }
        if !matches!(self.link.phase(), Phase::Closed(_)) {
            let out = self.link.take_output();
            let port = self.port.transport();
            let mut bytes = Vec::new();
            let sent = if out.is_empty() { Ok(()) } else { port.write(now, &out) };
            match sent.and_then(|()| port.read(now, &mut bytes)) {
                Ok(()) => self.link.receive(now, &bytes),
                Err(error) => self.link.closed(Some(error.to_string())),
            }
            self.link.tick(now);
            // What the tick or an answer made ready goes out at once.
            let out = self.link.take_output();
            if !out.is_empty()
                && let Err(error) = self.port.transport().write(now, &out)
            {
                self.link.closed(Some(error.to_string()));
            }
        }
        while let Some(event) = self.link.take_event() {
            if let Event::Log(way, text) = &event
                && self.show_log
            {
                eprintln!("{}", super::log_line(now, *way, text));
            }
            self.events.push(event);
        }
        Ok(())
    }

    /// Events since the last call.
    pub fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    /// Waits until something may have happened, at most until `until`.
    pub fn sleep(&mut self, until: Option<Duration>) {
        let now = self.now();
        let port = match &self.port {
            Port::Simulated(port) => port.next_event(),
            #[cfg(feature = "serial")]
            Port::Native(_) => None,
        };
        let next = [until, self.link.next_wake(now), port].into_iter().flatten().min().unwrap_or(FOREVER);
        if self.real_time {
            // A native port tells nothing beforehand: look every millisecond.
            let left = next.saturating_sub(now).min(Duration::from_millis(1));
            std::thread::sleep(left.max(Duration::from_micros(200)));
        } else {
            self.now = next.max(now + Duration::from_micros(100)).min(now + Duration::from_millis(100));
        }
    }

    /// Carries out a command and waits for its end.
    ///
    /// # Errors
    /// [`Failure`] of the command.
    pub fn execute(&mut self, command: Command) -> Result<(), Failure> {
        self.execute_until(command, Duration::MAX)
    }

    fn execute_until(&mut self, command: Command, end: Duration) -> Result<(), Failure> {
        let now = self.now();
        let ticket = self.link.send(now, command)?;
        while self.now() <= end {
            if let Err(error) = self.pump() {
                return Err(Failure::Disconnected(error.to_string()));
            }
            for event in self.take_events() {
                if let Event::Done(done, result) = event
                    && done == ticket
                {
                    return result;
                }
            }
            self.sleep(None);
        }
        Err(Failure::NoAnswer("the last command".into()))
    }

    /// Puts the LED out where something ended badly: as well as can be, without an error that would hide the first.
    /// A closed port takes nothing; an alarm, a stop or a restart has put it out already.
    pub fn light_off(&mut self) {
        let end = self.now() + Duration::from_secs(3);
        match self.execute_until(Command::Light(0.0), end) {
            // A held firmware answers no line. Its reset puts the LED out too.
            Err(Failure::NoAnswer(_)) => self.stop(),
            Err(Failure::Stopped) => {}
            _ => return,
        }
        let end = self.now() + Duration::from_secs(1);
        while self.now() <= end && *self.link.phase() == Phase::Stopped(false) {
            if self.pump().is_err() {
                return;
            }
            self.sleep(None);
        }
    }

    /// Stop.
    pub fn stop(&mut self) {
        let now = self.now();
        self.link.stop(now);
    }

    /// Ends a stop.
    ///
    /// # Errors
    /// [`Failure`] while the firmware has not confirmed it.
    pub fn release(&mut self) -> Result<(), Failure> {
        let now = self.now();
        self.link.release(now)
    }

    /// Feed hold.
    pub fn hold(&mut self) {
        self.link.hold();
    }

    /// Resume.
    ///
    /// # Errors
    /// [`Failure::Stopped`] after Stop.
    pub fn resume(&mut self) -> Result<(), Failure> {
        self.link.resume()
    }

    /// Opens the port again, for as long as a USB port takes to come back (8 s).
    ///
    /// # Errors
    /// Where it does not.
    pub fn reconnect(&mut self) -> anyhow::Result<()> {
        let end = self.now() + Duration::from_secs(8);
        loop {
            match self.open() {
                Ok(()) => return self.wait_ready(),
                Err(error) if self.now() >= end || self.interrupted.load(Ordering::Relaxed) => {
                    return Err(error).context("the port did not come back");
                }
                Err(_) => {
                    if self.real_time {
                        std::thread::sleep(Duration::from_millis(250));
                    } else {
                        self.now += Duration::from_millis(250);
                    }
                }
            }
        }
    }
}

#[cfg(not(feature = "serial"))]
fn native_port(name: &str) -> anyhow::Result<Port> {
    bail!(
        "{name}: this build has no serial ports (cargo build --features serial); --arm sim is the simulated arm"
    )
}

#[cfg(feature = "serial")]
fn native_port(name: &str) -> anyhow::Result<Port> {
    Ok(Port::Native(native::Native::new(name)))
}

/// Names of the serial ports and what is known about them.
#[cfg(not(feature = "serial"))]
pub fn ports() -> anyhow::Result<Vec<(String, String)>> {
    bail!("this build has no serial ports: cargo build --features serial")
}

/// Names of the serial ports and what is known about them.
#[cfg(feature = "serial")]
pub fn ports() -> anyhow::Result<Vec<(String, String)>> {
    native::ports()
}

#[cfg(feature = "serial")]
mod native {
    use super::{Duration, Transport};
    use coil_ps::arm::TransportError;
    use serialport::{ErrorKind, SerialPort, SerialPortType};
    use std::io::ErrorKind as Io;

    /// A serial port of this machine, 115200 8-N-1.
    pub struct Native {
        name: String,
        port: Option<Box<dyn SerialPort>>,
    }

    impl Native {
        pub fn new(name: &str) -> Self {
            Self { name: name.into(), port: None }
        }

        pub fn open(&mut self) -> Result<(), TransportError> {
            self.port = None; // let go of the old one first
            let name = self.name.clone();
            let builder = serialport::new(&name, 115_200).timeout(Duration::from_millis(200));
            let port = builder.open().map_err(|error| match error.kind {
                ErrorKind::NoDevice if error.to_string().to_lowercase().contains("busy") => TransportError::Busy(name.clone()),
                ErrorKind::Io(Io::ResourceBusy) => TransportError::Busy(name.clone()),
                ErrorKind::Io(Io::PermissionDenied) => TransportError::Open {
                    port: name.clone(),
                    reason: "not allowed: on Linux add yourself to the group dialout (sudo usermod -aG dialout $USER) and log in again".into(),
                },
                ErrorKind::NoDevice | ErrorKind::Io(Io::NotFound) => TransportError::Open {
                    port: name.clone(),
                    reason: "no such port: coil arm ports lists those there are".into(),
                },
                _ => TransportError::Open { port: name.clone(), reason: error.to_string() },
            })?;
            self.port = Some(port);
            Ok(())
        }
    }

    fn lost(error: impl std::fmt::Display) -> TransportError {
        TransportError::Lost(error.to_string())
    }

    impl Transport for Native {
        fn write(&mut self, _: Duration, bytes: &[u8]) -> Result<(), TransportError> {
            self.port.as_mut().ok_or_else(|| lost("not open"))?.write_all(bytes).map_err(lost)
        }

        fn read(&mut self, _: Duration, into: &mut Vec<u8>) -> Result<(), TransportError> {
            let port = self.port.as_mut().ok_or_else(|| lost("not open"))?;
            let waiting = port.bytes_to_read().map_err(lost)? as usize;
            if waiting > 0 {
                let mut buffer = vec![0; waiting.min(4096)];
                let n = port.read(&mut buffer).map_err(lost)?;
                into.extend_from_slice(&buffer[..n]);
            }
            Ok(())
        }
    }

    pub fn ports() -> anyhow::Result<Vec<(String, String)>> {
        let about = |kind: &SerialPortType| match kind {
            SerialPortType::UsbPort(usb) => format!(
                "USB {:04x}:{:04x} {} {}",
                usb.vid,
                usb.pid,
                usb.manufacturer.as_deref().unwrap_or_default(),
                usb.product.as_deref().unwrap_or_default()
            ),
            SerialPortType::BluetoothPort => "Bluetooth".into(),
            SerialPortType::PciPort => "built in".into(),
            SerialPortType::Unknown => String::new(),
        };
        Ok(serialport::available_ports()?.into_iter().map(|p| (p.port_name, about(&p.port_type))).collect())
    }
}
