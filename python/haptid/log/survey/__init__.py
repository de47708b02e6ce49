"""What a log contains, and a `[channels]` table to begin with."""

from haptid.log.survey.channels import ChannelSurvey, Quantity, Survey, TopicSurvey
from haptid.log.survey.read import survey

__all__ = ["ChannelSurvey", "Quantity", "Survey", "TopicSurvey", "survey"]
