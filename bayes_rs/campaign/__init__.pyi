from .campaign_posterior import CampaignPosterior as CampaignPosterior
from .mast import prior_from_stresses as prior_from_stresses
from .table import campaign_table as campaign_table
