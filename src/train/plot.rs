//! The curve of a training run as an SVG picture.

use super::fit::Report;
use super::validate::Errors;
use serde::Deserialize;
use std::fmt::Write as _;

#[derive(Deserialize)]
struct Line {
    #[serde(flatten)]
    report: Option<Report>,
    validation: Option<Point>,
    baselines: Option<Vec<(String, Errors)>>,
}

#[derive(Deserialize)]
struct Point {
    after: u64,
    degrees: Errors,
}

const WIDTH: f64 = 760.0;
const HEIGHT: f64 = 420.0;
const MARGIN: f64 = 48.0;

/// Validation error at T = 10 over updates, the baselines as lines across, and the smoothed training loss on the same
/// axis of updates. `log` is a run's log of JSON lines; lines that can't be read are passed over.
#[must_use]
pub fn training(log: &str) -> String {
    let lines: Vec<Line> = log.lines().filter_map(|l| serde_json::from_str(l).ok()).collect();
    let points: Vec<(f64, f64)> = lines
        .iter()
        .filter_map(|l| l.validation.as_ref().map(|v| (v.after as f64, v.degrees.last())))
        .collect();
    let losses = smooth(lines.iter().filter_map(|l| l.report.map(|r| (r.step as f64, r.loss))));
    let baselines: Vec<(String, f64)> = lines
        .iter()
        .filter_map(|l| l.baselines.as_ref())
        .flatten()
        .map(|(name, e)| (name.clone(), e.last()))
        .collect();
    let last = losses.last().map_or(1.0, |l| l.0).max(1.0);
    let top = points.iter().map(|p| p.1).chain(baselines.iter().map(|b| b.1)).fold(1.0, f64::max) * 1.05;
    let top_loss = losses.iter().map(|l| l.1).fold(1e-9, f64::max) * 1.05;
    let x = |step: f64| MARGIN + (WIDTH - 4.0 * MARGIN) * step / last;
    let y = |value: f64, top: f64| HEIGHT - MARGIN - (HEIGHT - 2.0 * MARGIN) * value / top;

    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" font-family=\"sans-serif\" \
         font-size=\"12\"><rect width=\"100%\" height=\"100%\" fill=\"white\"/>"
    );
    for k in 0..=(top / 2.0) as u32 {
        let v = f64::from(2 * k);
        let _ = write!(
            svg,
            "<line x1=\"{MARGIN}\" x2=\"{:.1}\" y1=\"{1:.1}\" y2=\"{1:.1}\" stroke=\"#eee\"/>\
             <text x=\"{2:.1}\" y=\"{3:.1}\" text-anchor=\"end\">{v}</text>",
            x(last),
            y(v, top),
            MARGIN - 6.0,
            y(v, top) + 4.0
        );
    }
    for (name, value) in &baselines {
        let at = y(*value, top);
        let _ = write!(
            svg,
            "<line x1=\"{MARGIN}\" x2=\"{0:.1}\" y1=\"{at:.1}\" y2=\"{at:.1}\" stroke=\"#999\" stroke-dasharray=\"4 3\"/>\
             <text x=\"{1:.1}\" y=\"{2:.1}\" fill=\"#666\" font-size=\"10\">{name}</text>",
            x(last),
            x(last) + 6.0,
            at + 3.0
        );
    }
    let path = |points: &[(f64, f64)], top: f64| {
        points.iter().map(|p| format!("{:.1},{:.1}", x(p.0), y(p.1, top))).collect::<Vec<_>>().join(" ")
    };
    let _ = write!(
        svg,
        "<polyline points=\"{}\" fill=\"none\" stroke=\"#bcd\"/>\
         <polyline points=\"{}\" fill=\"none\" stroke=\"#06c\" stroke-width=\"2\"/>",
        path(&losses, top_loss),
        path(&points, top)
    );
    let _ = write!(
        svg,
        "<text x=\"{MARGIN}\" y=\"20\">validation error at T = 10, degrees (dark); training loss, own scale (light)</text>\
         <text x=\"{0:.1}\" y=\"{1:.1}\" text-anchor=\"middle\">updates (0 to {last})</text></svg>",
        WIDTH / 2.0,
        HEIGHT - 12.0
    );
    svg
}

/// A running mean over about fifty updates.
fn smooth(points: impl Iterator<Item = (f64, f64)>) -> Vec<(f64, f64)> {
    let mut mean: Option<f64> = None;
    points
        .map(|(step, v)| {
            let m = mean.map_or(v, |m| m + (v - m) / 50.0);
            mean = Some(m);
            (step, m)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_becomes_a_picture_and_bad_lines_do_no_harm() {
        let log = "{\"baselines\":[[\"ring 35\",[9.0,8.0,7.5]]]}\n\
            {\"step\":1,\"loss\":0.3,\"last\":0.1,\"gradient\":1.0,\"rate\":0.001,\"seconds\":0.5}\n\
            not json\n{\"validation\":{\"after\":1,\"degrees\":[9.0,8.0,7.0],\"spread\":3.0}}\n";
        let svg = training(log);
        assert!(svg.contains("ring 35") && svg.ends_with("</svg>") && svg.contains("<polyline"));
        assert!(training("").ends_with("</svg>"));
    }
}
