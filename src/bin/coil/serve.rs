//! `coil serve`: builds what is stale of the page and serves it on loopback.

mod build;
mod http;

use anyhow::Context;
use build::{Board, Builder, MODULES, State};
use std::path::PathBuf;
use std::process::{Command, ExitCode, Stdio};
use std::sync::Arc;

/// Options of `coil serve`.
#[derive(clap::Args)]
pub struct ServeArgs {
    /// TCP port on 127.0.0.1; where it is taken, the system picks another. 0: always let it pick.
    #[arg(long, default_value_t = 8017)]
    port: u16,
    /// Do not open a browser.
    #[arg(long)]
    no_open: bool,
    /// Serve what was built before, without building.
    #[arg(long, conflicts_with = "build_only")]
    no_build: bool,
    /// Write the page as static files to target/page, for any web server, and stop.
    #[arg(long)]
    build_only: bool,
    /// Build the named modules only. The page works without `policy`, except for the learned planners.
    #[arg(long, value_delimiter = ',', value_parser = build::module_names(), default_values = build::module_names())]
    modules: Vec<String>,
    /// Checkout of coil-ps to build. [default: the one that this program was compiled from]
    #[arg(long)]
    root: Option<PathBuf>,
}

/// Runs the subcommand; serves until the process is ended.
///
/// # Errors
/// No checkout, no wasm32 target, code that does not compile, or no port to listen on.
pub fn run(args: ServeArgs) -> anyhow::Result<ExitCode> {
    let root = args.root.unwrap_or_else(|| env!("CARGO_MANIFEST_DIR").into());
    let builder = Arc::new(Builder::new(root)?);
    let board = Arc::new(Board::default());
    let wanted = MODULES.iter().filter(|module| args.modules.iter().any(|name| name == module.name));
    let (first, later): (Vec<_>, Vec<_>) = wanted.partition(|module| module.needed_at_once);

    if args.no_build {
        for module in first.into_iter().chain(later) {
            board.set(module.name, builder.state_on_disk(module));
        }
    } else {
        for module in first {
            builder.build(module, &board)?;
        }
        if args.build_only {
            for module in later {
                builder.build(module, &board)?;
            }
            builder.write_static_site(&board)?;
            println!("page: {}", builder.page_dir().display());
            return Ok(ExitCode::SUCCESS);
        }
        for module in &later {
            board.set(module.name, State::Waiting);
        }
        let (builder, board) = (Arc::clone(&builder), Arc::clone(&board));
        // the page works meanwhile; a failure is on the board, which the page shows
        std::thread::spawn(move || {
            for module in later {
                if let Err(error) = builder.build_quietly(module, &board) {
                    eprintln!("error: module {}: {error:#}", module.name);
                }
            }
        });
    }

    let server = http::listen(args.port)?;
    let address = server.server_addr().to_ip().context("the server has no IP address")?;
    let url = format!("http://{address}/");
    println!("page: {url}  (Ctrl-C ends)");
    if !args.no_open {
        open_in_browser(&url);
    }
    http::serve(&server, &http::Site { folders: builder.served_folders(), board });
    Ok(ExitCode::SUCCESS)
}

/// Asks the desktop to show `url`. Without a desktop nothing happens: the URL was printed.
fn open_in_browser(url: &str) {
    let program = if cfg!(target_os = "macos") {
        "open"
    } else if cfg!(windows) {
        "explorer"
    } else if ["DISPLAY", "WAYLAND_DISPLAY"].iter().any(|name| std::env::var_os(name).is_some()) {
        "xdg-open"
    } else {
        return;
    };
    let quiet = Command::new(program)
        .arg(url)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn();
    if quiet.is_err() {
        eprintln!("could not start {program}; open the page by hand");
    }
}
