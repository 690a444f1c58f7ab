//! Exposure, gain and trigger of a camera by its driver's controls. Pure: what is to be written follows from
//! what is wanted and from the controls that there are.

use settings::commands::cameras::{Trigger, Wanted};

/// The kernel's meaning of a control.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Meaning {
    /// `V4L2_CID_AUTOGAIN`.
    AutoGain,
    /// `V4L2_CID_GAIN`.
    Gain,
    /// `V4L2_CID_EXPOSURE_AUTO`.
    ExposureAuto,
    /// `V4L2_CID_EXPOSURE_ABSOLUTE`.
    Exposure,
}

/// `V4L2_EXPOSURE_MANUAL`.
const MANUAL: i32 = 1;
/// Unit of `EXPOSURE_ABSOLUTE`, µs.
const EXPOSURE_UNIT_US: i64 = 100;

/// A control of a driver.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Control {
    /// Its meaning, where it is one of those that are used here.
    pub meaning: Option<Meaning>,
    /// The driver's name.
    pub name: String,
    /// Least value.
    pub minimum: i32,
    /// Largest value.
    pub maximum: i32,
    /// From one value to the next; 0 or 1 where every value is allowed.
    pub step: i32,
    /// Entries of a menu: value and name.
    pub menu: Vec<(i32, String)>,
}

/// A value to be written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Write {
    /// The control's place in the list.
    pub control: usize,
    /// Its value.
    pub value: i32,
    /// What that means, for messages and the report.
    pub text: String,
}

/// What is to be written, in this order.
///
/// # Errors
/// A control that the camera lacks or a value that it does not take, in words that follow its name.
pub fn plan(wanted: &Wanted, controls: &[Control]) -> Result<Vec<Write>, String> {
    let place = |meaning| controls.iter().position(|c| c.meaning == Some(meaning));
    let find = |meaning| place(meaning).map(|at| (at, &controls[at]));
    let mut writes = Vec::new();
    if let Some(us) = wanted.exposure_us {
        let none = "has no adjustable exposure: omit exposure_us";
        let (at, control) = find(Meaning::Exposure).ok_or(none)?;
        let us = i64::from(us);
        let value = fitting(control, "exposure_us", us, EXPOSURE_UNIT_US)?;
        let by_hand = |control| Write { control, value: MANUAL, text: "manual exposure".into() };
        writes.extend(place(Meaning::ExposureAuto).map(by_hand));
        writes.push(Write { control: at, value, text: format!("exposure {us} µs") });
    }
    if let Some(gain) = wanted.gain {
        let (at, control) = find(Meaning::Gain).ok_or("has no adjustable gain: omit gain")?;
        let value = fitting(control, "gain", i64::from(gain), 1)?;
        let by_hand = |control| Write { control, value: 0, text: "manual gain".into() };
        writes.extend(place(Meaning::AutoGain).map(by_hand));
        writes.push(Write { control: at, value, text: format!("gain {gain}") });
    }
    if let Some(trigger) = wanted.trigger {
        writes.push(trigger_of(trigger, controls)?);
    }
    Ok(writes)
}

/// The kernel knows no trigger; drivers that have one name it so.
fn trigger_of(trigger: Trigger, controls: &[Control]) -> Result<Write, String> {
    let named = |c: &Control| c.name.to_lowercase().contains("trigger mode");
    let found = controls.iter().enumerate().find(|(_, c)| named(c));
    let (at, control) = found.ok_or("has no control \"Trigger Mode\": omit trigger")?;
    let words: &[&str] = match trigger {
        Trigger::External => &["external", "on", "hardware"],
        Trigger::Internal => &["internal", "off", "free run", "disabled"],
    };
    let fits = |name: &str| words.iter().any(|word| name.to_lowercase().starts_with(word));
    let entry = control.menu.iter().find(|(_, name)| fits(name)).map(|(value, _)| *value);
    let text = format!("trigger {}", trigger.name());
    let is_switch = control.menu.is_empty() && (control.minimum, control.maximum) == (0, 1);
    match entry.or(is_switch.then_some(i32::from(trigger == Trigger::External))) {
        Some(value) => Ok(Write { control: at, value, text }),
        None => {
            let entries: Vec<&str> = control.menu.iter().map(|(_, name)| name.as_str()).collect();
            Err(format!("has no {text} in its {}: {}", control.name, entries.join(", ")))
        }
    }
}

/// `asked` in a control's unit; the error says which values it takes.
fn fitting(control: &Control, key: &str, asked: i64, unit: i64) -> Result<i32, String> {
    let step = i64::from(control.step.max(1));
    let fits = |value: &i32| {
        let above = i64::from(*value) - i64::from(control.minimum);
        (control.minimum..=control.maximum).contains(value) && asked % unit == 0 && above % step == 0
    };
    i32::try_from(asked / unit).ok().filter(fits).ok_or_else(|| {
        let [low, high] = [control.minimum, control.maximum].map(|v| i64::from(v) * unit);
        let steps = if step * unit > 1 { format!(" in steps of {}", step * unit) } else { String::new() };
        format!("expected {key}={low} to {high}{steps}, found {asked}")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn control(meaning: Option<Meaning>, name: &str, range: [i32; 3], menu: &[&str]) -> Control {
        let menu = menu.iter().enumerate().map(|(i, entry)| (i as i32, (*entry).to_owned())).collect();
        let [minimum, maximum, step] = range;
        Control { meaning, name: name.into(), minimum, maximum, step, menu }
    }

    fn webcam() -> Vec<Control> {
        vec![
            control(Some(Meaning::AutoGain), "Gain, Automatic", [0, 1, 1], &[]),
            control(Some(Meaning::Gain), "Gain", [0, 100, 2], &[]),
            control(Some(Meaning::ExposureAuto), "Auto Exposure", [0, 3, 1], &["Auto Mode", "Manual Mode"]),
            control(Some(Meaning::Exposure), "Exposure Time, Absolute", [3, 2047, 1], &[]),
            control(None, "Trigger Mode", [0, 1, 1], &[]),
        ]
    }

    #[test]
    fn automatics_are_switched_off_before_values_are_written() {
        let wanted = Wanted { exposure_us: Some(2_000), gain: Some(4), trigger: Some(Trigger::External) };
        let writes = plan(&wanted, &webcam()).unwrap();
        let pairs: Vec<(usize, i32)> = writes.iter().map(|w| (w.control, w.value)).collect();
        let expected = [(2, 1), (3, 20), (0, 0), (1, 4), (4, 1)];
        assert_eq!(pairs, expected);
        assert_eq!(plan(&Wanted::default(), &[]).unwrap(), []);
    }

    #[test]
    fn a_trigger_is_found_in_a_menu() {
        let menu = control(None, "Trigger Mode", [0, 2, 1], &["Free Run", "Software", "External"]);
        let of = |trigger| {
            plan(&Wanted { trigger: Some(trigger), ..Wanted::default() }, std::slice::from_ref(&menu))
        };
        assert_eq!(of(Trigger::External).unwrap()[0].value, 2);
        assert_eq!(of(Trigger::Internal).unwrap()[0].value, 0);
        let other = [Control { menu: vec![(3, "Lamp".into())], ..menu.clone() }];
        let told =
            plan(&Wanted { trigger: Some(Trigger::External), ..Wanted::default() }, &other).unwrap_err();
        assert!(told.contains("no trigger external in its Trigger Mode: Lamp"), "{told}");
    }

    #[test]
    fn what_a_camera_does_not_take_is_refused_in_words() {
        let none = Wanted::default();
        for (wanted, controls, named) in [
            (Wanted { exposure_us: Some(2_000), ..none }, vec![], "no adjustable exposure"),
            (Wanted { gain: Some(1), ..none }, vec![], "no adjustable gain"),
            (Wanted { trigger: Some(Trigger::Internal), ..none }, vec![], "no control \"Trigger Mode\""),
            (
                Wanted { exposure_us: Some(2_050), ..none },
                webcam(),
                "exposure_us=300 to 204700 in steps of 100, found 2050",
            ),
            (Wanted { exposure_us: Some(900_000), ..none }, webcam(), "found 900000"),
            (Wanted { gain: Some(5), ..none }, webcam(), "gain=0 to 100 in steps of 2, found 5"),
            (Wanted { gain: Some(-2), ..none }, webcam(), "found -2"),
        ] {
            let told = plan(&wanted, &controls).unwrap_err();
            assert!(told.contains(named), "{told}");
        }
    }
}
