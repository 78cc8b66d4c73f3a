//! Several devices in one process: a chain on each, among which independent images are shared.

use crate::{Error, Result};

/// One device of a group.
pub struct GroupMember<C> {
    /// Name of the device in reports.
    pub name: String,
    /// The chain on the device.
    pub chain: C,
    /// Images a second in the last piece that it finished; none before the first.
    pub images_per_s: Option<f64>,
}

/// Chains of one model on several devices. Work that is not shared runs on the first.
pub struct DeviceGroup<C> {
    /// At least one.
    members: Vec<GroupMember<C>>,
    /// Devices that are not used any more, as sentences.
    failure: Option<String>,
}

impl<C> DeviceGroup<C> {
    /// Chains of one model, with the names of their devices; `left_out` are devices that cannot run
    /// it, and why.
    ///
    /// # Errors
    /// [`Error::Device`] where there is no chain.
    pub(crate) fn new(chains: Vec<(String, C)>, left_out: &[String]) -> Result<Self> {
        let reasons = left_out.join("; ");
        if chains.is_empty() {
            return Err(Error::Device(format!("no device can run this model: {reasons}")));
        }
        let member = |(name, chain)| GroupMember { name, chain, images_per_s: None };
        let failure = (!left_out.is_empty()).then(|| format!("devices are left out: {reasons}"));
        Ok(Self { members: chains.into_iter().map(member).collect(), failure })
    }

    /// The devices.
    pub fn members_mut(&mut self) -> &mut [GroupMember<C>] {
        &mut self.members
    }

    /// Removes the devices that failed, by their place and why: the others have their images.
    ///
    /// # Errors
    /// [`Error::Device`] where none remains.
    pub fn retire(&mut self, failed: &[(usize, String)]) -> Result<()> {
        if failed.len() == self.members.len() {
            let reasons: Vec<&str> = failed.iter().map(|(_, reason)| reason.as_str()).collect();
            return Err(Error::Device(format!("all devices have failed: {}", reasons.join("; "))));
        }
        let sentence = |(place, reason): &(usize, String)| {
            format!("{} failed, and the other devices have taken its images: {reason}", self.members[*place].name)
        };
        let sentences: Vec<String> = self.failure.iter().cloned().chain(failed.iter().map(sentence)).collect();
        self.failure = (!sentences.is_empty()).then(|| sentences.join("; "));
        let mut places = 0..;
        self.members.retain(|_| places.next().is_some_and(|place| failed.iter().all(|(gone, _)| *gone != place)));
        Ok(())
    }

    /// Devices that failed or are left out, as sentences.
    pub fn failure(&self) -> Option<&str> {
        self.failure.as_deref()
    }

    /// Names of the devices in reports.
    pub(super) fn names(&self) -> String {
        self.members.iter().map(|member| member.name.as_str()).collect::<Vec<_>>().join(", ")
    }

    /// The chain for work that is not shared.
    pub(super) fn first(&self) -> &C {
        &self.members[0].chain
    }

    pub(super) fn first_mut(&mut self) -> &mut C {
        &mut self.members[0].chain
    }
}
