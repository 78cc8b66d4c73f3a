//! Setting: a key of the scene and a value for it, where the key is known at run time alone: a
//! value that a file states, or one that a check proposes.

use super::edit::after_settings;
use super::own_form::rounded;
use super::sections::Sections;
use super::value::SettingValue;
use super::{Parameter, Scene, System, forms};
use crate::{Error, Result};
use std::fmt;

/// A key of the scene, as `section.key`, and a value for it.
#[derive(Debug, Clone, PartialEq)]
pub struct Setting {
    key: String,
    value: SettingValue,
    text: String,
}

impl Setting {
    pub(crate) fn new(key: impl Into<String>, value: impl Into<SettingValue>) -> Self {
        let value = value.into();
        let text = match &value {
            SettingValue::Number(number) => number.to_string(),
            SettingValue::Numbers(numbers) => format!("{numbers:?}"),
            SettingValue::Flag(flag) => flag.to_string(),
        };
        Self { key: key.into(), value, text }
    }

    /// A number of six decimals.
    pub(crate) fn of_six_decimals(key: impl Into<String>, number: f64) -> Self {
        let text = format!("{number:.6}");
        Self { key: key.into(), value: text.parse().unwrap_or(number).into(), text }
    }

    /// The key, as `section.key`.
    pub fn key(&self) -> &str {
        &self.key
    }

    /// The value in the syntax of TOML.
    pub fn text(&self) -> &str {
        &self.text
    }

    pub(crate) fn value(&self) -> &SettingValue {
        &self.value
    }

    /// The quantity in the form in which `scene` names it: see [`Scene::own_form`].
    pub(crate) fn in_form_of(self, scene: &Scene) -> Self {
        let converted = self.value.number().map(|number| scene.own_form(&self.key, number));
        match converted.filter(|(own, _)| *own != self.key) {
            Some((own, number)) => Self::new(own, rounded(number)),
            None => self,
        }
    }
}

/// As a scene has it: `image.flip_x = true`.
impl fmt::Display for Setting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} = {}", self.key, self.text)
    }
}

impl Sections {
    /// The value of `key` as a setting; `None` for a key without a value, and for values that are
    /// words or names of files.
    pub(crate) fn setting(&self, key: &str) -> Option<Setting> {
        let (section, name) = key.split_once('.')?;
        self.value(section, name).map(|value| Setting::new(key, value))
    }

    /// Sets the key of a setting; another form of the same quantity gives way.
    ///
    /// # Errors
    /// [`Error::Internal`] for a key that does not exist or has values of another type.
    fn apply(&mut self, Setting { key, value, .. }: &Setting) -> Result<()> {
        let (section, name) = key.split_once('.').unwrap_or_default();
        if !self.set_value(section, name, Some(value)) {
            return Err(Error::Internal(format!("no setting of {key} is {value:?}")));
        }
        // The form that everything reads is no option: it follows from the one that is set.
        for other in forms::other_forms(section, name) {
            self.set_value(section, other, None);
        }
        Ok(())
    }
}

impl Parameter {
    /// Its value; not a number only of a key that does not exist.
    pub(crate) fn get(&self, sections: &Sections) -> f64 {
        sections.setting(self.key).and_then(|setting| setting.value.number()).unwrap_or(f64::NAN)
    }

    /// Sets the value; other forms of the quantity give way. Every row of the table can: a test
    /// sets each.
    pub(crate) fn set(&self, sections: &mut Sections, value: f64) {
        let done = sections.apply(&Setting::new(self.key, value));
        debug_assert!(done.is_ok(), "{done:?}");
    }
}

impl System {
    /// This system with these values.
    ///
    /// # Errors
    /// As [`System::with`]; the sentence names the settings.
    pub(crate) fn with_settings(&self, settings: &[Setting]) -> Result<Self> {
        let pairs: Vec<(&str, &str)> = settings.iter().map(|one| (one.key(), one.text())).collect();
        self.changed(&pairs, &|sections| settings.iter().try_for_each(|one| sections.apply(one)))
            .map_err(|error| after_settings(error, &pairs))
    }
}

impl Scene {
    /// This scene with these values, which its text has, too.
    ///
    /// # Errors
    /// As [`System::with_settings`].
    pub(crate) fn with_settings(&self, settings: &[Setting]) -> Result<Self> {
        self.adopting(&self.system.with_settings(settings)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keck(settings: &[(&str, &str)]) -> Scene {
        Scene::preset("keck-artificial").unwrap().with(settings).unwrap()
    }

    #[test]
    fn settings_change_a_scene_as_their_text_does() {
        let settings = [
            Setting::new("image.wavelength_nm", 2200.0),
            Setting::new("image.flip_x", true),
            Setting::new("image.read_noise_e", 3.0),
            Setting::new("pupil.rings", 2.0),
            Setting::new("pupil.spider_angles_deg", SettingValue::Numbers(vec![0.0, 90.0])),
            Setting::new("image.samples_per_lambda_over_d", 3.0),
            Setting::of_six_decimals("pupil.rotation_deg", 1.0 / 3.0),
        ];
        for scene in [keck(&[]), keck(&[("image.pixel_mas", "10")])] {
            for setting in &settings {
                let of_text = scene.with(&[(setting.key(), setting.text())]).unwrap();
                let typed = scene.with_settings(std::slice::from_ref(setting)).unwrap();
                assert_eq!(typed.system(), of_text.system(), "{setting}");
                assert_eq!(typed.setting(setting.key()).unwrap().value(), setting.value());
                let read = Scene::from_text(typed.text(), std::path::Path::new("")).unwrap();
                assert_eq!(read.system(), typed.system(), "{setting}");
            }
        }
        // The form that a scene names gives way, and back.
        let sampling = &settings[5];
        let own = sampling.clone().in_form_of(&keck(&[("image.pixel_mas", "10")]));
        assert_eq!((own.key(), own.text().len()), ("image.pixel_mas", 8), "{own}");
        let back = keck(&[]).with_settings(std::slice::from_ref(&own)).unwrap();
        assert!((back.image.samples_per_lambda_over_d / 3.0 - 1.0).abs() < 1e-6);
        assert!(!back.names(sampling.key()) && back.names(own.key()));
    }

    #[test]
    fn a_refused_setting_is_named_as_its_text_is() {
        let scene = keck(&[]);
        for (key, number) in [("image.wavelength_nm", 1.5), ("pupil.central_obscuration_m", 20.5)] {
            let setting = Setting::new(key, number);
            let text = scene.with(&[(key, setting.text())]).unwrap_err().to_string();
            assert_eq!(scene.with_settings(&[setting]).unwrap_err().to_string(), text);
        }
        assert!(scene.with_settings(&[Setting::new("image.no", 1.0)]).unwrap_err().to_string().contains("image.no"));
    }

    #[test]
    fn a_number_is_rounded_where_it_is_converted() {
        let scene = keck(&[("image.pixel_mas", "10")]);
        let value = scene.image.samples_per_lambda_over_d / 1.04;
        let own = Setting::new("image.samples_per_lambda_over_d", value).in_form_of(&scene);
        assert_eq!(own.to_string(), "image.pixel_mas = 10.4");
        let same = Setting::new("pupil.rotation_deg", 30.123456789);
        assert_eq!(same.clone().in_form_of(&scene), same);
    }
}
